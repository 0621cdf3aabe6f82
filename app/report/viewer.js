// The bodies of one run or of several, drawn with three.js from the numbers of `viewer.py`.
(async function () {
  "use strict";
  const NONE = 65535, LEVELS = 65534, CLIP = 0.995;
  const colours = list => list.map(h => new THREE.Color("#" + h));
  // Viridis, and blue to red for what has a sign: colour-blind people read both.
  const VIRIDIS = colours(["440154", "482475", "414487", "355f8d", "2a788e", "21918c", "22a884", "44bf70",
    "7ad151", "bddf26", "fde725"]);
  const SIGNED = colours(["2166ac", "4393c3", "92c5de", "d1e5f0", "f7f7f7", "fddbc7", "f4a582", "d6604d", "b2182b"]);
  const TINTS = colours(["9aa4ad", "c9b7d8", "e6d9bd", "d8c3a5", "b8cfc4", "cfc4b8"]);
  const root = document.getElementById("view");
  const make = (tag, into, props) => into.appendChild(Object.assign(document.createElement(tag), props));
  const words = (data, at, count) => new Uint16Array(data.slice(at, at + 2 * count));
  const shown = v => Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(2) : String(+v.toPrecision(4));
  const said = name => name.replace(/_/g, " ");
  const plane = new THREE.Plane(), ray = new THREE.Raycaster(), middle = new THREE.Vector3();
  const controls = root.insertBefore(document.createElement("div"), root.firstChild);
  let views;
  try {
    views = await Promise.all([...root.querySelectorAll(".one")].map(build));
  } catch (error) {
    make("p", root, { className: "quiet", textContent: "This browser does not draw in three dimensions: " + error.message });
    return;
  }
  const first = views[0].head, size = first.points.width, last = first.stages[first.stages.length - 1];
  const turns = first.turned.length > 0;
  const labels = new Map(views.flatMap(v => v.head.fields.map(f => [f.name, f.label]))), fields = [...labels.keys()];
  const opening = first.opening;
  const state = { field: opening.field || fields[0], stage: last, scale: +turns, axis: opening.axis, cut: 0.5, hidden: new Set() };
  const bounds = views.reduce((b, v) => b.union(v.bounds), new THREE.Box3());
  const radius = bounds.getSize(new THREE.Vector3()).length() / 2;
  let seen = radius; // radius of what is visible

  // Controls: one set for all views.
  const bar = make("div", controls, { className: "bar" });
  const select = (title, names, change) => {
    const label = make("label", bar, { textContent: title + " " });
    const list = make("select", label, {});
    names.forEach((name, k) => make("option", list, { value: k, textContent: name }));
    list.onchange = () => change(+list.value);
    return list;
  };
  const fieldSelect = select("field", [...labels.values()], k => show(fields[k], state.stage));
  const stageSelect = select("at the end of", first.ends, k => { halt(); state.motion = false; show(state.field, first.ends[k]); });
  stageSelect.parentNode.hidden = first.ends.length < 2;
  const slider = (title, start, change) => {
    const label = make("label", bar, { textContent: title + " " });
    const range = make("input", label, { type: "range", min: 0, max: 100, value: start });
    const text = make("span", label, {});
    range.oninput = () => { text.textContent = " " + change(range.value / 100); views.forEach(v => v.draw()); };
    return range;
  };
  const most = Math.max(...first.moves.map(m => m.most));
  const deformation = slider("deformation", turns ? 100 : 0, part => {
    // At the end of the slider the largest displacement is a fifth of the model; a body that turns
    // is where it is.
    state.scale = turns ? part : part ? Math.round(part * 0.2 * size / (most || 1)) : 0;
    views.forEach(v => v.deform());
    return "× " + state.scale;
  });
  const cutSelect = select("cut", ["nowhere", "across x", "across y", "across z"], k => { state.axis = k - 1; clip(); });
  cutSelect.value = state.axis + 1;
  slider("", 50, part => { state.cut = part; clip(); return ""; });
  // Motion: the steps one after another. Colours then span the values of all steps.
  const motionBar = make("div", controls, { className: "bar motion", hidden: first.stages.length < 2 });
  const play = make("button", motionBar, { type: "button", textContent: "play" });
  const stepRange = make("input", motionBar, { type: "range", min: 0, max: first.stages.length - 1, ariaLabel: "step" });
  const stepText = make("span", motionBar, {});
  stepRange.oninput = () => { halt(); go(+stepRange.value); };
  let timer = 0;
  function halt() { clearInterval(timer); timer = 0; play.textContent = "play"; }
  function go(k) { state.motion = true; show(state.field, first.stages[k]); }
  // The next step that has the field; after the last one the first.
  function next() {
    const steps = views[0].field ? views[0].field.steps : first.stages, n = steps.length;
    for (let i = 1, k = first.stages.indexOf(state.stage); i <= n; i++) if (steps[(k + i) % n]) return go((k + i) % n);
  }
  play.onclick = () => {
    if (timer) return halt();
    if (!state.scale && +deformation.value === 0) { deformation.value = 30; deformation.oninput(); }
    play.textContent = "pause";
    timer = setInterval(next, Math.max(60, 4000 / first.stages.length));
  };
  const bodyBar = make("div", controls, { className: "bar" });
  const names = [...new Set(views.flatMap(v => v.meshes.map(m => m.name)))];
  names.filter(n => !opening.bodies.includes(n)).forEach(n => state.hidden.add(n));
  const checks = names.map(name => {
    const label = make("label", bodyBar, {});
    const box = make("input", label, { type: "checkbox", checked: !state.hidden.has(name) });
    label.append(" " + said(name));
    box.onchange = () => { state.hidden[box.checked ? "delete" : "add"](name); paint(); };
    return box;
  });
  for (const [name, x, y] of [["anterior", 0, 1], ["medial", 1, 0], ["posterior", 0, -1], ["lateral", -1, 0]])
    make("button", bodyBar, { type: "button", textContent: name }).onclick = () => look(x, y, 0);
  make("button", bodyBar, { type: "button", textContent: "largest value" }).onclick = () => views.forEach(v => v.largest());

  // A field at the end of a stage.
  function show(field, stage) {
    Object.assign(state, { field, stage });
    fieldSelect.value = fields.indexOf(field);
    stageSelect.value = first.ends.indexOf(stage);
    const k = stepRange.value = first.stages.indexOf(stage), n = first.stages.length, all = first.recorded;
    stepText.textContent = "step " + (k + 1) + " of " + n + ": " + said(stage) + (n < all ? "; this page has " + n + " of " + all + " recorded steps" : "");
    views.forEach(v => v.choose());
    paint();
  }
  // Colours span percentiles of the values on visible bodies; compared runs have one range.
  function paint() {
    const ranges = views.map(v => v.range()), common = ranges.filter((r, k) => !views[k].head.signed);
    views.forEach((v, k) => {
      const most = Math.max(...ranges[k].slice(0, 2).map(Math.abs));
      v.paint(...(v.head.signed ? [-most, most] : [Math.min(...common.map(r => r[0])), Math.max(...common.map(r => r[1]))]), ranges[k]);
      v.deform();
    });
    clip();
  }
  function clip() {
    const axis = Math.max(0, state.axis), low = bounds.min.toArray()[axis], high = bounds.max.toArray()[axis];
    plane.set(new THREE.Vector3(...[0, 1, 2].map(k => k === axis ? -1 : 0)), low + state.cut * (high - low));
    for (const v of views) { v.clip(); v.draw(); }
  }
  // Look at what is visible from a direction.
  function look(x, y, z) {
    const all = views.reduce((b, v) => b.union(v.extent()), new THREE.Box3());
    if (all.isEmpty()) all.copy(bounds);
    all.getCenter(middle);
    seen = all.getSize(new THREE.Vector3()).length() / 2;
    for (const v of views) {
      v.camera.position.set(middle.x + 4 * radius * x, middle.y + 4 * radius * y, middle.z + 4 * radius * z);
      v.controls.target.copy(middle);
      v.camera.zoom = 1;
      v.resize();
      v.controls.update();
    }
  }
  // One camera for all.
  for (const v of views) v.controls.addEventListener("change", () => {
    for (const o of views.filter(o => o !== v)) {
      o.camera.position.copy(v.camera.position);
      o.camera.quaternion.copy(v.camera.quaternion);
      o.camera.zoom = v.camera.zoom;
      o.controls.target.copy(v.controls.target);
      o.camera.updateProjectionMatrix();
      o.draw();
    }
    v.draw();
  });
  window.addEventListener("resize", () => views.forEach(v => v.resize()));
  window.mantleView = { views, state, show, look, clip, checks, go, next, play };
  show(state.field, state.stage);
  look(...(state.axis < 0 ? [0.6, 0.8, 0.25] : [0.3, 0.9, 0.15]));
  root.dataset.ready = "yes";

  // One run: the z axis of its model points up.
  async function build(box) {
    const head = JSON.parse(box.querySelector(".head").textContent), n = head.points.n;
    const packed = Uint8Array.from(atob(box.querySelector(".data").textContent), c => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const data = await new Response(stream).arrayBuffer();
    const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    renderer.localClippingEnabled = true;
    const rest = Float32Array.from(words(data, head.points.at, 3 * n), (v, k) => v / LEVELS * head.points.width + head.points.low[k % 3]);
    const position = new THREE.BufferAttribute(new Float32Array(rest), 3);
    const v = { head, bounds: new THREE.Box3().setFromBufferAttribute(position) };
    const far = 40 * v.bounds.getSize(new THREE.Vector3()).length();
    const map = head.signed ? SIGNED : VIRIDIS;
    const stage = make("div", box, { className: "stage" });
    stage.append(renderer.domElement);
    const legend = make("div", stage, { className: "legend" }), ramp = make("div", legend, { className: "ramp" });
    const highest = make("span", ramp, {}), lowest = make("span", ramp, {}), unit = make("div", legend, {});
    const ends = make("div", box, { className: "ends" });
    ramp.style.background = "linear-gradient(to top," + map.map(c => "#" + c.getHexString()).join(",") + ")";
    const output = make("output", stage, { className: "output" });
    const scene = new THREE.Scene();
    scene.background = new THREE.Color("#ffffff");
    const camera = v.camera = new THREE.OrthographicCamera(-1, 1, 1, -1, far / 1e4, far);
    camera.up.set(0, 0, 1);
    const light = new THREE.DirectionalLight(0xffffff, 0.38);
    camera.add(light);
    scene.add(new THREE.AmbientLight(0xffffff, 0.72), camera);
    v.controls = new THREE.OrbitControls(camera, renderer.domElement);
    v.draw = () => renderer.render(scene, camera);
    let values;
    v.meshes = head.bodies.map((body, k) => {
      const geometry = new THREE.BufferGeometry();
      geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(data.slice(body.at, body.at + 12 * body.triangles)), 1));
      geometry.setAttribute("position", position);
      geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * n), 3));
      const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ vertexColors: THREE.VertexColors, side: THREE.DoubleSide }));
      const cells = new Uint32Array(data.slice(body.inside, body.inside + 16 * body.cells));
      // The section of its cells with the plane of the cut.
      const section = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial({
        vertexColors: THREE.VertexColors, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 4 }));
      // Its outline, in front of the section.
      const outline = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: "#1d2429" }));
      Object.assign(section, { name: body.name, frustumCulled: false });
      outline.frustumCulled = false;
      const nodes = new Set([...geometry.index.array, ...cells]);
      Object.assign(mesh, { name: body.name, tint: TINTS[k % TINTS.length], cells, nodes, section, outline });
      scene.add(mesh, section, outline);
      return mesh;
    });
    const visible = () => v.meshes.filter(m => !state.hidden.has(m.name));
    const dot = new THREE.Mesh(new THREE.SphereGeometry(far / 7200, 16, 12), new THREE.MeshBasicMaterial({ color: "#d1495b" }));
    dot.renderOrder = head.bodies.length;
    scene.add(dot);
    const worth = k => values[k] === NONE ? NaN : v.step.min + values[k] / LEVELS * (v.step.max - v.step.min);
    v.extent = () => {
      const around = new THREE.Box3(), corner = new THREE.Vector3();
      for (const mesh of visible()) for (const k of mesh.geometry.index.array) around.expandByPoint(corner.fromBufferAttribute(position, k));
      return around;
    };
    v.choose = () => {
      const at = state.stage === last ? head.stages.length - 1 : head.stages.indexOf(state.stage);
      v.field = head.fields.find(f => f.name === state.field);
      v.step = at < 0 || !v.field ? null : v.field.steps[at];
      values = v.step ? words(data, v.step.at, n) : new Uint16Array(n).fill(NONE);
      v.moves = at < 0 ? { u: new Uint16Array(3 * n), most: 0 } : { u: words(data, head.moves[at].at, 3 * n), most: head.moves[at].most };
    };
    // Ends of the colours, then the least and the largest value. Without a unit values are states.
    v.range = () => {
      const key = state.motion && v.field && v.field.name + [...state.hidden];
      if (key && v.whole && v.whole.key === key) return v.whole.range;
      const every = [...new Set(visible().flatMap(mesh => [...mesh.nodes]))], worths = [], now = [values, v.step];
      for (const step of key ? v.field.steps.filter(s => s) : [v.step]) {
        if (key) { values = words(data, step.at, n); v.step = step; }
        for (const k of every) { const value = worth(k); if (!isNaN(value)) worths.push(value); }
      }
      [values, v.step] = now;
      const range = spans(Float64Array.from(worths).sort());
      if (key) v.whole = { key, range };
      return range;
    };
    const spans = known => {
      if (!known.length) return [Infinity, -Infinity, 0, 0];
      const least = known[0], most = known[known.length - 1];
      if (!v.field.unit) return [least, most, least, most];
      const at = part => known[Math.round(part * (known.length - 1))];
      const [low, high] = [at(1 - CLIP), at(CLIP)];
      return high > low ? [low, high, least, most] : [least, most, least, most];
    };
    // The colour of a value; what has none keeps the tint of its body.
    function colour(value, tint, into) {
      const [least, most] = v.span;
      if (isNaN(value) || !(most > least && most < Infinity)) return into.copy(tint);
      const part = Math.max(0, Math.min(1, (value - least) / (most - least))) * (map.length - 1);
      const low = Math.min(Math.floor(part), map.length - 2);
      return into.copy(map[low]).lerp(map[low + 1], part - low);
    }
    v.paint = (least, most, [, , smallest, largest]) => {
      v.span = [least, most];
      const c = new THREE.Color();
      for (const mesh of v.meshes) {
        const attribute = mesh.geometry.getAttribute("color");
        for (let k = 0; k < n; k++) {
          colour(worth(k), mesh.tint, c);
          attribute.setXYZ(k, c.r, c.g, c.b);
        }
        attribute.needsUpdate = true;
      }
      legend.hidden = !(v.step && most >= least && most < Infinity);
      highest.textContent = shown(most);
      lowest.textContent = shown(Math.abs(least) < 1e-9 * Math.abs(most) ? 0 : least);
      unit.textContent = v.step ? v.field.label + (v.field.unit ? " (" + v.field.unit + ")" : "") : "";
      const beyond = largest > most || smallest < least;
      const start = shown(smallest) !== shown(least) ? "least " + shown(smallest) + ", " : "";
      const values = start + "largest " + shown(largest);
      ends.textContent = beyond ? "colours end at the " + 100 * CLIP + "th percentile; " + values : "";
      output.textContent = v.step ? "" : v.field ? "in this page at the ends of stages" : "not in this run";
    };
    v.deform = () => {
      for (let k = 0; k < 3 * n; k++) position.array[k] = rest[k] + state.scale * (2 * v.moves.u[k] / LEVELS - 1) * v.moves.most;
      position.needsUpdate = true;
      for (const m of v.meshes) { m.geometry.computeVertexNormals(); m.geometry.boundingSphere = null; }
      mark();
    };
    v.clip = () => {
      for (const mesh of v.meshes) {
        mesh.visible = !state.hidden.has(mesh.name);
        mesh.material.clippingPlanes = state.axis < 0 ? [] : [plane];
        mesh.section.visible = mesh.outline.visible = mesh.visible && state.axis >= 0;
        if (mesh.section.visible) { fill(mesh); outlined(mesh); }
      }
      mark();
    };
    function height(k) {
      const p = position.array;
      return plane.normal.x * p[3 * k] + plane.normal.y * p[3 * k + 1] + plane.normal.z * p[3 * k + 2] + plane.constant;
    }
    // Lines in which the plane meets the surface of a body.
    function outlined(mesh) {
      const places = [], p = position.array, corners = mesh.geometry.index.array;
      for (let k = 0; k < corners.length; k += 3) for (let i = 0; i < 3; i++) {
        const a = corners[k + i], b = corners[k + (i + 1) % 3];
        if (height(a) > 0 === height(b) > 0) continue;
        const t = height(a) / (height(a) - height(b));
        for (let j = 0; j < 3; j++) places.push(p[3 * a + j] + t * (p[3 * b + j] - p[3 * a + j]));
      }
      mesh.outline.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(places), 3));
    }
    // Triangles of a body's cells in the plane, with values: a cell is cut in three edges or four.
    function fill(mesh) {
      const places = [], colours = [], rests = [], values = [], c = new THREE.Color(), p = position.array;
      const add = (a, b) => {
        const t = height(a) / (height(a) - height(b)), value = worth(a) + t * (worth(b) - worth(a));
        for (let i = 0; i < 3; i++) {
          places.push(p[3 * a + i] + t * (p[3 * b + i] - p[3 * a + i]));
          rests.push(rest[3 * a + i] + t * (rest[3 * b + i] - rest[3 * a + i]));
        }
        colour(value, mesh.tint, c);
        colours.push(c.r, c.g, c.b);
        values.push(value);
      };
      for (let k = 0; k < mesh.cells.length; k += 4) {
        const above = [], below = [];
        for (let i = k; i < k + 4; i++) (height(mesh.cells[i]) > 0 ? above : below).push(mesh.cells[i]);
        const [one, other] = above.length < below.length ? [above, below] : [below, above];
        if (one.length === 1) for (const b of other) add(one[0], b);
        if (one.length === 2) for (const [a, b] of [[0, 0], [0, 1], [1, 1], [0, 0], [1, 1], [1, 0]]) add(one[a], other[b]);
      }
      const geometry = mesh.section.geometry;
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(places), 3));
      geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(colours), 3));
      geometry.boundingSphere = geometry.boundingBox = null;
      Object.assign(mesh.section, { rests, values });
    }
    // The largest value on what is visible; of what has a sign the largest of both.
    function mark() {
      let best = -1, most = -Infinity;
      for (const mesh of visible()) for (const k of mesh.geometry.index.array) {
        const value = values[k] === NONE ? NaN : head.signed ? Math.abs(worth(k)) : values[k];
        if (value > most) { most = value; best = k; }
      }
      dot.visible = best >= 0;
      if (best >= 0) dot.position.fromBufferAttribute(position, best);
      return best;
    }
    v.largest = () => {
      const k = mark();
      if (k < 0) return;
      const at = [0, 1, 2].map(i => shown(rest[3 * k + i]));
      output.textContent = "largest: " + shown(worth(k)) + " " + v.field.unit + " at (" + at.join(", ") + ") mm";
    };
    // The value under the pointer (x, y from -1 to 1), linear on its triangle.
    v.pick = (x, y) => {
      ray.setFromCamera({ x, y }, camera);
      const cut = state.axis >= 0, drawn = visible(), sections = cut ? drawn.map(m => m.section) : [];
      const hit = ray.intersectObjects([...drawn, ...sections]).find(h => h.object.values || !cut || plane.distanceToPoint(h.point) >= 0);
      if (!hit) return null;
      const shape = hit.object.values ? hit.object : { rests: rest }, at = hit.object.geometry.getAttribute("position");
      const corners = [hit.face.a, hit.face.b, hit.face.c], part = new THREE.Vector3();
      THREE.Triangle.getBarycoord(hit.point, ...corners.map(k => new THREE.Vector3().fromBufferAttribute(at, k)), part);
      const parts = part.toArray(), sum = f => corners.reduce((s, k, i) => s + parts[i] * f(k), 0);
      const value = sum(k => shape.values ? shape.values[k] : worth(k));
      return { body: hit.object.name, place: [0, 1, 2].map(i => sum(k => shape.rests[3 * k + i])), value };
    };
    renderer.domElement.addEventListener("pointermove", event => {
      const r = renderer.domElement.getBoundingClientRect();
      const hit = v.pick(2 * (event.clientX - r.left) / r.width - 1, 1 - 2 * (event.clientY - r.top) / r.height);
      output.textContent = hit ? said(hit.body) + (isNaN(hit.value) ? "" : ": " + shown(hit.value) + " " + v.field.unit) +
        " at (" + hit.place.map(p => p.toFixed(1)).join(", ") + ") mm" : "";
    });
    v.resize = () => {
      const width = stage.clientWidth || 800, height = Math.min(620, Math.max(320, 0.62 * width));
      renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
      renderer.setSize(width, height);
      const half = 1.05 * seen, wide = half * width / height;
      Object.assign(camera, { left: -wide, right: wide, top: half, bottom: -half });
      camera.updateProjectionMatrix();
      v.draw();
    };
    return v;
  }
})();
