// A stem that is moved in a bone, drawn with three.js from the numbers of `placement_page.py`.
(async function () {
  "use strict";
  const $ = id => document.getElementById(id);
  const head = JSON.parse($("head").textContent);
  const packed = Uint8Array.from(atob($("data").textContent), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = await new Response(stream).arrayBuffer();
  const LEVELS = 65534; // of a fraction, as in `packed_arrays.py`
  const TYPES = { i2: Int16Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array };
  const array = a => new TYPES[a.type](data, a.at, a.shape.reduce((n, k) => n * k, 1));
  const places = a => Float32Array.from(array(a), (v, k) => a.low[k % 3] + v / LEVELS * a.width);
  const make = (tag, into, props) => into.appendChild(Object.assign(document.createElement(tag), props));
  const RAD = Math.PI / 180;
  const ENOUGH = 0.005; // mm of room for which the stem is moved

  // Numbers, as in `meshes.placement` and `meshes.room`.

  const { normal, level, way } = head.cut, grid = head.grid, distances = array(grid);
  // Axes of the stem as columns, its origin, and the height of the cut on its axis.
  function placed(p, stem) {
    const [c, s] = [Math.cos(p.version * RAD), Math.sin(p.version * RAD)];
    const [cv, sv] = [Math.cos(p.varus * RAD), Math.sin(p.varus * RAD)];
    const [cf, sf] = [Math.cos(p.flexion * RAD), Math.sin(p.flexion * RAD)];
    const tilted = [[cv, -sv * sf, sv * cf], [0, cf, sf], [-sv, -cv * sf, cv * cf]];
    const turn = [tilted[0].map((v, k) => c * v - s * tilted[1][k]), tilted[0].map((v, k) => s * v + c * tilted[1][k]), tilted[2]];
    const aside = [p.medial * way[0] - p.anterior * way[1], p.medial * way[1] + p.anterior * way[0]];
    const foot = [...aside, (level - normal[0] * aside[0] - normal[1] * aside[1]) / normal[2]];
    const along = k => normal[0] * turn[0][k] + normal[1] * turn[1][k] + normal[2] * turn[2][k];
    const top = stem.shoulder - along(0) / along(2) * stem.lateral + p.depth;
    const slope = along(0) / along(2), lean = Math.abs(along(1)) > 1e-12 ? Math.max(-3, Math.min(3, along(1) / along(0))) : 0; // 3: placement.MOST_LEAN
    return { turn, top, slope, lean, origin: foot.map((v, k) => v - top * turn[k][2]) };
  }
  // Points along the stem in its axes, section by section, as `meshes.room.StemSurface.placed_points`, and
  // whether the neck clears the cut.
  function surfaceAt(q, stem) {
    if (stem.points) return [stem.points, true];
    const { along, neck_along, deep, out, shoulder, clear, blend } = head.stem, around = stem.start.length, { slope: steep, lean, top } = q;
    const edge = stem.shoulder - steep * stem.lateral, low = edge < top - deep ? edge : top;
    const sine = Math.sin(stem.neck.angle), cosine = -Math.cos(stem.neck.angle), [offset, , height] = stem.head, length = offset / sine;
    const flat = Math.max(out, steep), proud = stem.shoulder - flat * stem.lateral;
    const [base, slope] = proud > top + shoulder ? [proud, flat] : [low, steep];
    const buried = Math.max(top - low, 0), room = low === top ? clear : stem.neck.fillet + buried / Math.hypot(slope, 1);
    const long = Math.hypot(slope, 1), rise = (sine * slope + cosine) / long, dip = stem.neck.radii[0] * Math.sqrt(Math.max(0, 1 - rise * rise));
    const foot = [offset - length * sine, height - length * cosine];
    const needed = (room + dip - (slope * foot[0] + foot[1] - base) / long) / (rise * length), part = Math.max(blend[0], needed);
    const ring = (x, z, r, i) => {
      const turn = 2 * Math.PI * i / around;
      return [x + r * Math.cos(turn) * cosine, r * Math.sin(turn), z - r * Math.cos(turn) * sine];
    };
    const points = new Float32Array(3 * around * (along + 2 * (neck_along - 1)));
    for (let i = 0; i < around; i++) {
      const [a, w] = [stem.start[i], stem.way[i]], over = x => slope * (x[0] + lean * x[1]) + x[2];
      const end = a.map((v, k) => v + (base - over(a)) / over(w) * w[k]);
      const first = ring(foot[0] + part * length * sine, foot[1] + part * length * cosine, stem.neck.radii[0], i), last = ring(offset, height, stem.neck.radii[1], i);
      let row = 0;
      const line = (from, to, steps, begin) => { for (let k = begin; k < steps; k++, row++) points.set(from.map((v, j) => v + k / (steps - 1) * (to[j] - v)), 3 * (row * around + i)); };
      line(a, end, along, 0);
      line(end, first, neck_along, 1);
      line(first, last, neck_along, 1);
    }
    return [points, rise > 0 && needed <= blend[1]];
  }
  const moved = (q, x) => q.origin.map((o, k) => o + q.turn[k][0] * x[0] + q.turn[k][1] * x[1] + q.turn[k][2] * x[2]);
  const above = x => normal[0] * x[0] + normal[1] * x[1] + normal[2] * x[2] - level;
  // Distance of a point from the widest possible canal, positive within: linear between nodes.
  function roomAt(x) {
    const [, m, n] = grid.shape, i = [], part = [];
    let beyond = 0;
    for (let k = 0; k < 3; k++) {
      const at = (x[k] - grid.low[k]) / grid.step[k], most = grid.shape[k] - 1, within = Math.min(Math.max(at, 0), most);
      beyond += ((at - within) * grid.step[k]) ** 2;
      i[k] = Math.min(Math.floor(within), most - 1);
      part[k] = within - i[k];
    }
    const [a, b, c] = part, at = (i[0] * m + i[1]) * n + i[2];
    const edge = k => (1 - c) * distances[at + k] + c * distances[at + k + 1];
    const room = (1 - a) * ((1 - b) * edge(0) + b * edge(n)) + a * ((1 - b) * edge(m * n) + b * edge(m * n + n));
    return grid.unit * room - Math.sqrt(beyond);
  }
  function interpolated(x, table) {
    let k = 0;
    while (k < table.length - 2 && x > table[k + 1][0]) k++;
    const [[x0, y0], [x1, y1]] = [table[k], table[k + 1]];
    return x1 > x0 ? y0 + (y1 - y0) * Math.min(Math.max((x - x0) / (x1 - x0), 0), 1) : y1;
  }
  // Thickness of the mantle that is asked for, as `best_position.wanted_thickness`.
  function wanted(x, low, top) {
    if (!head.thickness.tables) return head.thickness.uniform || head.uncemented;
    const [heights, ring] = head.thickness.tables;
    let turn = Math.atan2(x[1], x[0]) / (2 * Math.PI) - ring[0][0];
    turn = ring[0][0] + turn - Math.floor(turn);
    const side = interpolated(turn, ring.map(([t], k) => [t, k])), whole = Math.floor(side);
    const wave = whole + 0.5 * (1 - Math.cos(Math.PI * (side - whole)));
    return interpolated((x[2] - low) / (top - low), heights) * interpolated(wave, ring.map(([, r], k) => [k, r]));
  }
  const cemented = !!head.thickness.tables || head.thickness.uniform > 0;
  const SIDES = ["medially", "antero-medially", "anteriorly", "antero-laterally", "laterally", "postero-laterally", "posteriorly", "postero-medially"];
  // Room along the stem below the cut, its least value with its place, and the head.
  function evaluate(p, stem) {
    const q = placed(p, stem), [points, clears] = surfaceAt(q, stem), n = points.length / 3, x = new Float32Array(3 * n), heights = new Float64Array(n);
    const room = new Float32Array(n).fill(NaN), cement = new Float32Array(n).fill(NaN);
    let least = Infinity, thinnest = Infinity, excess = Infinity, worst = null, worstLocal = null;
    const look = (at, local) => {
      const r = roomAt(at);
      if (r < least) [least, worst, worstLocal] = [r, at, local];
      const w = wanted(local, stem.tip, q.top), t = Math.min(r, w);
      if (t < thinnest) thinnest = t;
      if (r - w < excess) excess = r - w;
      return [r, t];
    };
    const local = k => [points[3 * k], points[3 * k + 1], points[3 * k + 2]];
    for (let k = 0; k < n; k++) {
      const at = moved(q, local(k));
      x.set(at, 3 * k);
      heights[k] = above(at);
      if (heights[k] < 0) [room[k], cement[k]] = look(at, local(k));
    }
    for (let k = 0; k + stem.around < n; k++) {
      const [low, high] = [heights[k], heights[k + stem.around]];
      if (low >= 0 || high < 0) continue;
      const part = low / (low - high), a = local(k), b = local(k + stem.around), on = a.map((v, i) => v + part * (b[i] - v));
      look(moved(q, on), on);
    }
    const side = worstLocal && Math.atan2(q.turn[1][0] * worstLocal[0] + q.turn[1][1] * worstLocal[1], q.turn[0][0] * worstLocal[0] + q.turn[0][1] * worstLocal[1]);
    const centre = moved(q, stem.head), neck = Math.atan2(q.turn[1][0], q.turn[0][0]);
    return {
      q, x, clears, room, cement, least, thinnest, excess, worst, centre,
      where: worst && SIDES[((Math.round(8 * side / (2 * Math.PI)) % 8) + 8) % 8],
      below: worst && Math.max(0, -above(worst) / normal[2]),
      offset: Math.hypot(centre[0], centre[1]), leg: centre[2] - head.head[2], version: neck / RAD,
      offsetChange: Math.hypot(centre[0], centre[1]) - Math.hypot(head.head[0], head.head[1]), versionChange: (neck - head.neck) / RAD,
    };
  }

  // State: a position in mm and degrees, its version from the model's x axis, and a size.

  const NUMBERS = [
    ["depth", "depth", "mm", -10, 14, 0.5], ["varus", "varus", "°", -8, 8, 0.5], ["flexion", "flexion", "°", -8, 8, 0.5],
    ["version", "version", "°", -40, 40, 1], ["lateral", "lateral shift (−medial_offset)", "mm", -10, 10, 0.5], ["anterior", "anterior shift", "mm", -10, 10, 0.5],
  ];
  const stems = head.stems.map(s => ({ ...s, points: s.points && array(s.points), around: s.start.length,
    rows: s.points ? s.points.shape[0] : head.stem.along + 2 * (head.stem.neck_along - 1) }));
  const zero = head.relative === "neck" ? head.neck / RAD : 0;
  const state = { p: { ...head.position }, size: Math.max(0, stems.findIndex(s => !s.yaml)) };
  let now = null;
  // A slider shows the version from its line, and lateral shift is the other way around than medial.
  const shown = key => key === "version" ? state.p.version - zero : key === "lateral" ? -state.p.medial : state.p[key];
  function change(key, value) {
    if (key === "version") state.p.version = value + zero;
    else if (key === "lateral") state.p.medial = -value;
    else state.p[key] = value;
    update();
  }
  const plain = (v, digits) => String(+v.toFixed(digits) + 0);
  const fixed = (v, digits) => (+v.toFixed(digits) + 0).toFixed(digits); // no "-0.0"
  const minus = text => text.replace("-", "−");
  const signed = (v, digits) => (+v.toFixed(digits) < 0 ? "−" : "+") + Math.abs(v).toFixed(digits);
  function yaml() {
    const p = state.p, lines = [];
    if (stems[state.size].yaml) lines.push("  " + stems[state.size].yaml);
    lines.push("  insertion:", `    depth: ${plain(p.depth, 3)} mm`, `    varus: ${plain(p.varus, 3)} deg`, `    flexion: ${plain(p.flexion, 3)} deg`,
      "    version:", `      relative_to: ${head.relative}`, `      angle: ${plain(p.version - zero, 3)} deg`,
      `    medial_offset: ${plain(p.medial, 3)} mm`, `    anterior_offset: ${plain(p.anterior, 3)} mm`);
    return lines.join("\n") + "\n";
  }
  // The best position of the search at this depth: linear between the depths that were searched, or one
  // of theirs, or that of the case. The stem stays where it is if none of them has more room.
  function best() {
    const table = stems[state.size].best, before = now.least, depth = state.p.depth;
    const rounded = p => ({ ...p, depth, version: +(p.version - zero).toFixed(1) + zero,
      ...Object.fromEntries(["varus", "flexion", "medial", "anterior"].map(key => [key, +p[key].toFixed(1)])) });
    const between = {};
    for (const key of ["varus", "flexion", "version", "medial", "anterior"])
      between[key] = interpolated(depth, table.map(b => [b.depth, b[key]]));
    const near = [...table].sort((a, b) => Math.abs(a.depth - depth) - Math.abs(b.depth - depth)).slice(0, 2);
    let [chosen, most] = [state.p, now.excess];
    for (const p of [{ ...head.position, depth }, rounded(between), ...near.map(rounded)]) {
      const { excess } = evaluate(p, stems[state.size]);
      if (excess > most + ENOUGH && most < head.reserve) [chosen, most] = [p, excess];
    }
    state.p = chosen;
    update();
    const gain = now.least - before, change = `${Math.abs(gain).toFixed(2)} mm ${gain < 0 ? "less" : "more"} than before`;
    $("gain").textContent = now.least < head.least
      ? `No position near the one of the case has room for this stem at this depth. The best ${roomWords(now.least)}. Take a smaller or shorter stem, or ream more.`
      : gain === 0 && most >= head.reserve ? `The stem stays: it has enough room here.`
      : gain === 0 ? `The stem stays: at this depth the search has no position with more room.`
      : `The least room is now ${now.least.toFixed(2)} mm, ${change}.`;
  }
  const roomWords = r => r < 0 ? `cuts ${(-r).toFixed(2)} mm into the cortex` : `leaves ${r.toFixed(2)} mm`;

  // Controls

  const LINE = head.condyles ? "condyles" : "neck";
  const VERSION = head.relative === LINE ? `Version is measured from the ${LINE}.`
    : `The slider and the key measure version from the ${head.relative}, the table from the ${LINE}.`;
  $("room").textContent = cemented ? `Room is the distance of the stem from the widest canal that reaming may make; cement needs at least ${head.least} mm.`
    : "Room is the distance of the stem from the cortex that must stay.";
  $("about").textContent = `${head.title}. ${head.side === "right" ? "Right" : "Left"} femur. ${VERSION}${head.collar ? " The collar is not drawn." : ""}`;
  const inputs = {};
  if (stems.length > 1) {
    const row = make("div", $("sliders"), { className: "row" });
    make("label", row, { textContent: "size", htmlFor: "size" });
    const size = make("select", row, { id: "size", className: "size" });
    stems.forEach((s, k) => make("option", size, { value: k, textContent: s.name }));
    size.value = state.size;
    size.onchange = () => { state.size = +size.value; reshape(); update(); };
  }
  for (const [key, name, unit, low, high, step] of NUMBERS) {
    const row = make("div", $("sliders"), { className: "row" });
    make("label", row, { textContent: name, htmlFor: "slider-" + key });
    const slider = make("input", row, { id: "slider-" + key, type: "range", min: low, max: high, step });
    const number = make("input", row, { type: "number", min: low, max: high, step: 0.1 });
    number.setAttribute("aria-label", `${name} in ${unit === "°" ? "degrees" : unit}`);
    make("span", row, { textContent: unit });
    slider.oninput = () => { $("gain").textContent = ""; change(key, +slider.value); };
    number.onchange = () => { if (number.value !== "") change(key, Math.min(high, Math.max(low, +number.value))); };
    inputs[key] = { slider, number };
  }
  $("best").onclick = best;
  $("reset").onclick = () => { state.p = { ...head.position }; $("gain").textContent = ""; update(); };
  $("copy").onclick = async () => {
    let done = true;
    try { await navigator.clipboard.writeText(yaml()); }
    catch (error) { $("yaml").select(); done = document.execCommand("copy"); }
    $("copied").textContent = done ? `copied: in ${head.source}, put it below geometry in place of its insertion` : "select the text above and copy it";
  };

  // The picture

  const scene = new THREE.Scene(), model = new THREE.Group();
  scene.background = new THREE.Color("#ffffff");
  if (head.side === "right") model.scale.x = -1; // the model of a right femur is its mirror image
  scene.add(model);
  const shape = (points, triangles) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
    geometry.computeVertexNormals();
    return geometry;
  };
  const surface = (geometry, material) => {
    const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, ...material }));
    model.add(mesh);
    return mesh;
  };
  const clear = (color, opacity) => ({ color, opacity, transparent: true, depthWrite: false });
  const flip = head.side === "right" ? -1 : 1;
  const kept = new THREE.Plane(new THREE.Vector3(-flip * normal[0], -normal[1], -normal[2]), level);
  const removed = new THREE.Plane(kept.normal.clone().negate(), -level);
  const whole = shape(places(head.bone.points), array(head.bone.triangles));
  const bone = surface(whole, { ...clear("#d8c3a5", 0.3), clippingPlanes: [kept] });
  surface(whole, { ...clear("#d8c3a5", 0.1), clippingPlanes: [removed] });
  const canal = surface(shape(places(head.canal.points), array(head.canal.triangles)), clear("#5b8fc7", 0.16));
  bone.renderOrder = 2; canal.renderOrder = 1;
  const sheet = new THREE.Mesh(new THREE.CircleGeometry(38, 48), new THREE.MeshBasicMaterial({ side: THREE.DoubleSide, ...clear("#2f6f4f", 0.14) }));
  sheet.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...normal));
  sheet.position.set(0, 0, level / normal[2]);
  const rim = new THREE.LineLoop(new THREE.CircleGeometry(38, 48), new THREE.LineBasicMaterial({ color: "#2f6f4f" }));
  rim.geometry.vertices.shift();
  sheet.add(rim);
  model.add(sheet);
  const dot = (color, radius) => {
    const mesh = new THREE.Mesh(new THREE.SphereGeometry(radius, 20, 14), new THREE.MeshBasicMaterial({ color }));
    model.add(mesh);
    return mesh;
  };
  const HEAD = 14; // radius of the ball that is drawn for the head (mm)
  const intact = dot("#2f6f4f", 2.2), centre = dot("#e07b00", 2.2), thin = dot("#c2185b", 1.3);
  const ball = new THREE.Mesh(new THREE.SphereGeometry(HEAD, 32, 24), new THREE.MeshLambertMaterial(clear("#e07b00", 0.18)));
  model.add(ball);
  intact.position.set(...head.head);
  thin.material.depthTest = false; // it is seen through bone and stem
  thin.renderOrder = 9;
  // Colours by room: dark red within the bone, red below what is needed, then viridis.
  const VIRIDIS = ["440154", "482475", "414487", "355f8d", "2a788e", "21918c", "22a884", "44bf70", "7ad151", "bddf26", "fde725"].map(h => new THREE.Color("#" + h));
  const most = cemented ? (head.thickness.tables ? Math.max(...head.thickness.tables[0].map(t => t[1])) : head.thickness.uniform) : 4;
  const METAL = new THREE.Color("#a9b2ba"), CUTS = new THREE.Color("#6b0f1a"), LOW = new THREE.Color("#d9443f"), tone = new THREE.Color();
  function colour(value) {
    if (isNaN(value)) return METAL;
    if (value < 0) return CUTS;
    if (value < head.least) return LOW;
    const part = Math.min((value - head.least) / Math.max(most - head.least, 1e-6), 1) * (VIRIDIS.length - 1), low = Math.min(Math.floor(part), VIRIDIS.length - 2);
    return tone.copy(VIRIDIS[low]).lerp(VIRIDIS[low + 1], part - low);
  }
  let body = null;
  function reshape() {
    if (body) { model.remove(body); body.geometry.dispose(); }
    const { rows, around } = stems[state.size], triangles = [];
    for (let k = 0; k < rows - 1; k++) for (let i = 0; i < around; i++) {
      const a = k * around + i, b = k * around + (i + 1) % around;
      triangles.push(a, b, b + around, a, b + around, a + around);
    }
    // Its ends.
    for (const k of [0, rows - 1]) for (let i = 1; i < around - 1; i++) triangles.push(k * around, k * around + i, k * around + i + 1);
    body = surface(shape(new Float32Array(3 * rows * around), Uint32Array.from(triangles)), { vertexColors: THREE.VertexColors });
    body.geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * rows * around), 3));
    body.frustumCulled = false;
  }
  const legend = $("legend");
  make("div", legend, { textContent: cemented ? "thickness of the cement (mm)" : "room to the cortex that must stay (mm)" });
  const key = (values, text, wide) => {
    const entry = make("div", legend, { className: "entry" }), ramp = make("span", entry, { className: wide ? "ramp" : "" });
    for (const value of values) make("i", ramp, {}).style.background = "#" + colour(value).getHexString();
    make("span", entry, { textContent: text });
  };
  const STEPS = 20;
  key(Array.from({ length: STEPS }, (_, k) => head.least + k / (STEPS - 1) * (most - head.least)), `${plain(head.least, 1)} to ${plain(most, 1)}${cemented ? "" : " and more"}`, true);
  if (head.least > 0) key([0], `below ${plain(head.least, 1)}`);
  key([-1], "in the cortex");
  const dots = make("div", legend, { className: "dots" });
  for (const [tint, text] of [["#2f6f4f", "intact head "], ["#e07b00", "new head "], ["#c2185b", "least room"]]) {
    make("i", dots, {}).style.background = tint;
    make("span", dots, { textContent: text });
  }

  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 1, 4000), stage = $("stage");
  camera.up.set(0, 0, 1);
  const light = new THREE.DirectionalLight(0xffffff, 0.5);
  camera.add(light);
  scene.add(new THREE.AmbientLight(0xffffff, 0.65), camera);
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  } catch (error) {
    renderer = null;
    make("p", stage, { className: "quiet", textContent: "This browser does not draw in three dimensions. The numbers are right all the same." });
  }
  const canvas = renderer ? renderer.domElement : document.createElement("canvas");
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableKeys = false; // arrow keys belong to the sliders
  controls.addEventListener("change", draw);
  if (renderer) {
    renderer.localClippingEnabled = true;
    canvas.tabIndex = 0;
    canvas.setAttribute("aria-label", "Bone, canal and stem in three dimensions; arrow keys rotate");
    stage.prepend(canvas);
  }
  let waiting = false; // for the next frame, in which all changes are drawn at once
  function draw() {
    if (!renderer || waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; renderer.render(scene, camera); });
  }
  const bounds = new THREE.Box3().setFromBufferAttribute(canal.geometry.getAttribute("position")).expandByPoint(new THREE.Vector3(...head.head).add(new THREE.Vector3(0, 0, 1.8 * HEAD)));
  bounds.expandByPoint(new THREE.Vector3(...evaluate(state.p, stems[state.size]).centre).add(new THREE.Vector3(0, 0, HEAD)));
  const middle = bounds.getCenter(new THREE.Vector3()), tall = bounds.getSize(new THREE.Vector3());
  middle.x *= flip;
  function resize() {
    const width = stage.clientWidth, height = stage.clientHeight, bar = $("views").offsetTop + $("views").offsetHeight;
    // The picture is below the buttons: its middle moves down by half of their height.
    const half = Math.max(0.53 * tall.z * height / (height - bar), 0.62 * tall.x * height / width);
    camera.setViewOffset(width, height, 0, -bar / 2, width, height);
    if (renderer) { renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1)); renderer.setSize(width, height); }
    Object.assign(camera, { top: half, bottom: -half, left: -half * width / height, right: half * width / height });
    camera.updateProjectionMatrix();
    draw();
  }
  // Medial is +x in the model and, of a left femur, in the picture.
  const VIEWS = { "from the front": [0, 1, 0], "from the side": [-flip, 0, 0], "from above": [0, 0.001, 1] };
  function view(name) {
    const [x, y, z] = VIEWS[name];
    camera.position.set(middle.x + 900 * x, middle.y + 900 * y, middle.z + 900 * z);
    controls.target.copy(middle);
    camera.zoom = name === "from above" ? Math.min(2.2, 0.45 * tall.z / tall.x) : 1;
    camera.updateProjectionMatrix();
    controls.update();
    draw();
  }
  for (const name of Object.keys(VIEWS)) make("button", $("views"), { type: "button", textContent: name }).onclick = () => view(name);
  canvas.addEventListener("keydown", event => {
    const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    const zoom = { "+": 1.1, "=": 1.1, "-": 1 / 1.1 }[event.key];
    if (!turns && !zoom) return;
    event.preventDefault();
    if (zoom) camera.zoom *= zoom;
    else {
      const out = camera.position.clone().sub(controls.target), ball = new THREE.Spherical().setFromVector3(new THREE.Vector3(out.y, out.z, out.x));
      ball.theta += turns[0];
      ball.phi = Math.min(Math.PI - 0.01, Math.max(0.01, ball.phi + turns[1]));
      const to = new THREE.Vector3().setFromSpherical(ball);
      camera.position.copy(controls.target).add(new THREE.Vector3(to.z, to.x, to.y));
    }
    camera.updateProjectionMatrix();
    controls.update();
    draw();
  });

  function update() {
    const stem = stems[state.size];
    now = evaluate(state.p, stem);
    for (const [key, , , , , step] of NUMBERS) {
      inputs[key].slider.value = shown(key);
      inputs[key].number.value = plain(shown(key), 1);
      inputs[key].slider.setAttribute("aria-valuetext", plain(shown(key), 1));
    }
    const fits = now.least >= head.least && now.clears, place = `${now.where}, ${fixed(now.below, 0)} mm below the cut`;
    $("verdict").className = fits ? "" : "bad";
    $("verdict").textContent = fits ? "The stem fits." : !now.clears
      ? "The neck does not clear the neck cut: put the stem less deep, or cut lower." : now.least < 0
      ? `The stem cuts ${(-now.least).toFixed(2)} mm into the cortex ${place}.`
      : `The stem leaves ${now.least.toFixed(2)} mm; at least ${head.least} mm are needed ${place}.`;
    $("short").textContent = `least room ${minus(fixed(now.least, 2))} mm`;
    $("short").className = fits ? "" : "bad";
    const rows = [
      ["least room around the stem", place, minus(fixed(now.least, 2)) + " mm"],
      ...cemented ? [["least thickness of the cement", "", Math.max(0, now.thinnest).toFixed(2) + " mm"]] : [],
      ["offset of the head", "against the intact head", `${now.offset.toFixed(1)} mm (${signed(now.offsetChange, 1)})`],
      ["leg length", "against the intact head", `${signed(now.leg, 1)} mm`],
      ["version", `from the ${LINE}; change`, `${minus(fixed(now.version, 1))}° (${signed(now.versionChange, 1)})`],
    ];
    $("numbers").textContent = "";
    for (const [name, more, value] of rows) {
      const row = make("tr", $("numbers"), {}), cell = make("td", row, { textContent: name });
      if (more) make("small", cell, { textContent: more });
      make("td", row, { textContent: value });
    }
    $("yaml").value = yaml();
    const position = body.geometry.getAttribute("position"), colours = body.geometry.getAttribute("color");
    position.array.set(now.x);
    now.cement.forEach((t, k) => { const c = colour(cemented ? t : now.room[k]); colours.setXYZ(k, c.r, c.g, c.b); });
    position.needsUpdate = colours.needsUpdate = true;
    body.geometry.computeVertexNormals();
    centre.position.set(...now.centre);
    ball.position.set(...now.centre);
    thin.position.set(...now.worst);
    draw();
  }
  reshape();
  resize();
  update();
  view("from the front");
  window.addEventListener("resize", resize);
  window.mantlePlace = { head, state, change, best, view, yaml, evaluate: (p, size = state.size) => evaluate(p, stems[size]), get now() { return now; } };
  await new Promise(requestAnimationFrame);
  document.documentElement.dataset.ready = String(Math.round(performance.now()));
})();
