// The bodies of a run: drawn with three.js from the numbers that `viewer.py` packed into the page.
(async function () {
  "use strict";
  const NONE = 65535, LEVELS = 65534;
  // Viridis, which colour-blind people read.
  const MAP = ["440154", "482475", "414487", "355f8d", "2a788e", "21918c", "22a884", "44bf70",
    "7ad151", "bddf26", "fde725"].map(h => new THREE.Color("#" + h));
  const TINTS = ["#9aa4ad", "#c9b7d8", "#e6d9bd", "#d8c3a5", "#b8cfc4", "#cfc4b8"];
  const box = document.getElementById("view");
  const head = JSON.parse(document.getElementById("view-head").textContent);
  const make = (tag, into, props) => into.appendChild(Object.assign(document.createElement(tag), props));
  let renderer;
  try {
    const packed = Uint8Array.from(atob(document.getElementById("view-data").textContent), c => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    var data = await new Response(stream).arrayBuffer();
    renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  } catch (error) {
    make("p", box, { className: "quiet", textContent: "This browser does not draw in three dimensions: " + error.message });
    return;
  }
  const n = head.points.n;
  const words = (at, count) => new Uint16Array(data.slice(at, at + 2 * count));
  const rest = Float32Array.from(words(head.points.at, 3 * n), v => v / LEVELS * head.size);
  const position = new THREE.BufferAttribute(new Float32Array(rest), 3);
  const colour = new THREE.BufferAttribute(new Float32Array(3 * n), 3);
  const state = { field: 0, stage: head.stages.length - 1, scale: 0, axis: -1, cut: 1 };
  let values, moves;

  // Controls
  const bar = make("div", box, { className: "bar" });
  const select = (title, names, change) => {
    const label = make("label", bar, { textContent: title + " " });
    const own = make("select", label, {});
    names.forEach((name, k) => make("option", own, { value: k, textContent: name }));
    own.onchange = () => change(+own.value);
    return own;
  };
  const fieldSelect = select("field", head.fields.map(f => f.label), k => show(k, state.stage));
  const stageSelect = select("at the end of", head.stages, k => show(state.field, k));
  stageSelect.value = state.stage;
  stageSelect.parentNode.hidden = head.stages.length < 2;
  const slider = (title, start, change) => {
    const label = make("label", bar, { textContent: title + " " });
    const own = make("input", label, { type: "range", min: 0, max: 100, value: start });
    const text = make("span", label, {});
    own.oninput = () => { text.textContent = " " + change(own.value / 100); draw(); };
    return own;
  };
  slider("deformation", 0, part => {
    // At the end of the slider the largest displacement is a fifth of the model.
    state.scale = part ? Math.round(part * 0.2 * head.size / (moves.most || 1)) : 0;
    deform();
    return "× " + state.scale;
  });
  select("cut", ["nowhere", "across x", "across y", "across z"], k => {
    state.axis = k - 1;
    clip();
  });
  slider("", 50, part => { state.cut = part; clip(); return ""; });
  const bodyBar = make("div", box, { className: "bar" });
  const stage = make("div", box, { className: "stage" });
  const legend = make("div", stage, { className: "legend" });
  const ramp = make("div", legend, { className: "ramp" });
  const highest = make("span", ramp, {}), lowest = make("span", ramp, {});
  ramp.style.background = "linear-gradient(to top," + MAP.map(c => "#" + c.getHexString()).join(",") + ")";
  const unit = make("div", legend, {});
  const told = make("output", stage, { className: "told" });

  // Scene: the z axis of the model points up.
  const scene = new THREE.Scene();
  scene.background = new THREE.Color("#ffffff");
  const middle = new THREE.Vector3();
  const bounds = new THREE.Box3().setFromBufferAttribute(position);
  const radius = bounds.getSize(new THREE.Vector3()).length() / 2;
  let seen = radius; // radius of what is visible
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.01 * radius, 20 * radius);
  camera.up.set(0, 0, 1);
  scene.add(new THREE.AmbientLight(0xffffff, 0.72), camera);
  const light = new THREE.DirectionalLight(0xffffff, 0.38);
  camera.add(light);
  const controls = new THREE.OrbitControls(camera, renderer.domElement);
  controls.addEventListener("change", draw);
  stage.insertBefore(renderer.domElement, legend);
  const plane = new THREE.Plane();
  const meshes = head.bodies.map((body, k) => {
    const geometry = new THREE.BufferGeometry();
    const index = new Uint32Array(data.slice(body.at, body.at + 12 * body.triangles));
    geometry.setIndex(new THREE.BufferAttribute(index, 1));
    geometry.setAttribute("position", position);
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * n), 3));
    geometry.computeVertexNormals();
    const material = new THREE.MeshLambertMaterial({ vertexColors: THREE.VertexColors, side: THREE.DoubleSide });
    const mesh = new THREE.Mesh(geometry, material);
    mesh.name = body.name;
    mesh.tint = new THREE.Color(TINTS[k % TINTS.length]);
    scene.add(mesh);
    const label = make("label", bodyBar, {});
    const check = make("input", label, { type: "checkbox", checked: true });
    label.append(" " + body.name.replace(/_/g, " "));
    check.onchange = () => { mesh.visible = check.checked; mark(); draw(); };
    mesh.check = check;
    return mesh;
  });
  const dot = new THREE.Mesh(new THREE.SphereGeometry(radius / 90, 16, 12),
    new THREE.MeshBasicMaterial({ color: "#d1495b" }));
  scene.add(dot);
  for (const [name, x, y] of [["anterior", 0, 1], ["medial", 1, 0], ["posterior", 0, -1], ["lateral", -1, 0]])
    make("button", bodyBar, { type: "button", textContent: name }).onclick = () => look(x, y, 0);
  make("button", bodyBar, { type: "button", textContent: "largest value" }).onclick = () => largest();

  const shown = v => Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(2) : String(+v.toPrecision(4));
  const worth = (step, k) => values[k] === NONE ? NaN : step.min + values[k] / LEVELS * (step.max - step.min);

  // Look at what is visible from a direction.
  function look(x, y, z) {
    const box = new THREE.Box3(), corner = new THREE.Vector3();
    for (const mesh of meshes.filter(m => m.visible))
      for (const k of mesh.geometry.index.array) box.expandByPoint(corner.fromBufferAttribute(position, k));
    if (box.isEmpty()) box.copy(bounds);
    box.getCenter(middle);
    seen = box.getSize(corner).length() / 2;
    camera.position.set(middle.x + 4 * radius * x, middle.y + 4 * radius * y, middle.z + 4 * radius * z);
    controls.target.copy(middle);
    camera.zoom = 1;
    resize();
    controls.update();
  }
  function deform() {
    for (let k = 0; k < 3 * n; k++)
      position.array[k] = rest[k] + state.scale * (2 * moves.u[k] / LEVELS - 1) * moves.most;
    position.needsUpdate = true;
    for (const m of meshes) m.geometry.computeVertexNormals();
    for (const m of meshes) m.geometry.boundingSphere = null;
    mark();
  }
  function clip() {
    const normal = [0, 0, 0];
    if (state.axis >= 0) {
      normal[state.axis] = -1;
      const low = bounds.min.toArray()[state.axis], high = bounds.max.toArray()[state.axis];
      plane.set(new THREE.Vector3(...normal), low + state.cut * (high - low));
    }
    renderer.clippingPlanes = state.axis >= 0 ? [plane] : [];
    draw();
  }
  // Colours: what has no value keeps the tint of its body.
  function show(field, at) {
    Object.assign(state, { field, stage: at });
    fieldSelect.value = field;
    stageSelect.value = at;
    const step = head.fields[field].steps[at];
    values = words(step.at, n);
    moves = { u: words(head.moves[at].at, 3 * n), most: head.moves[at].most };
    const c = new THREE.Color();
    for (const mesh of meshes) {
      const own = mesh.geometry.getAttribute("color");
      for (let k = 0; k < n; k++) {
        const part = values[k] / LEVELS * (MAP.length - 1), low = Math.min(Math.floor(part), MAP.length - 2);
        if (values[k] === NONE || step.max === step.min) c.copy(mesh.tint);
        else c.copy(MAP[low]).lerp(MAP[low + 1], part - low);
        own.setXYZ(k, c.r, c.g, c.b);
      }
      own.needsUpdate = true;
    }
    highest.textContent = shown(step.max);
    lowest.textContent = shown(Math.abs(step.min) < 1e-9 * Math.abs(step.max) ? 0 : step.min);
    unit.textContent = head.fields[field].label + (head.fields[field].unit ? " (" + head.fields[field].unit + ")" : "");
    deform();
    draw();
  }
  // The largest value on what is visible.
  function mark() {
    let best = -1, most = -1;
    for (const mesh of meshes.filter(m => m.visible))
      for (const k of mesh.geometry.index.array)
        if (values[k] !== NONE && values[k] > most) { most = values[k]; best = k; }
    dot.visible = best >= 0;
    if (best >= 0) dot.position.fromBufferAttribute(position, best);
    return best;
  }
  function largest() {
    const k = mark(), step = head.fields[state.field].steps[state.stage];
    if (k < 0) return;
    const at = [0, 1, 2].map(i => shown(rest[3 * k + i] + head.low[i]));
    told.textContent = "largest: " + shown(worth(step, k)) + " " + head.fields[state.field].unit + " at (" + at.join(", ") + ") mm";
  }
  // The value under the pointer (x, y from -1 to 1), linear on its triangle.
  const ray = new THREE.Raycaster();
  function pick(x, y) {
    ray.setFromCamera({ x, y }, camera);
    const hits = ray.intersectObjects(meshes.filter(m => m.visible));
    const hit = hits.find(h => state.axis < 0 || plane.distanceToPoint(h.point) >= 0);
    if (!hit) return null;
    const corners = [hit.face.a, hit.face.b, hit.face.c];
    const [a, b, c] = corners.map(k => new THREE.Vector3().fromBufferAttribute(position, k));
    const part = new THREE.Vector3();
    THREE.Triangle.getBarycoord(hit.point, a, b, c, part);
    const parts = part.toArray(), step = head.fields[state.field].steps[state.stage];
    const sum = f => corners.reduce((s, k, i) => s + parts[i] * f(k), 0);
    const place = [0, 1, 2].map(i => sum(k => rest[3 * k + i]) + head.low[i]);
    return { body: hit.object.name, place, value: sum(k => worth(step, k)) };
  }
  renderer.domElement.addEventListener("pointermove", event => {
    const r = renderer.domElement.getBoundingClientRect();
    const hit = pick(2 * (event.clientX - r.left) / r.width - 1, 1 - 2 * (event.clientY - r.top) / r.height);
    told.textContent = hit ? hit.body.replace(/_/g, " ") + (isNaN(hit.value) ? "" : ": " + shown(hit.value) + " " + head.fields[state.field].unit) +
      " at (" + hit.place.map(v => v.toFixed(1)).join(", ") + ") mm" : "";
  });
  function resize() {
    const width = stage.clientWidth || 800, height = Math.min(620, Math.max(320, 0.62 * width));
    renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
    renderer.setSize(width, height);
    const half = 1.05 * seen, wide = half * width / height;
    Object.assign(camera, { left: -wide, right: wide, top: half, bottom: -half });
    camera.updateProjectionMatrix();
    draw();
  }
  function draw() { renderer.render(scene, camera); }
  window.addEventListener("resize", resize);
  // A stem is looked at without what is around it.
  if (meshes.some(m => m.name === "stem"))
    for (const mesh of meshes) mesh.visible = mesh.check.checked = mesh.name === "stem";
  show(0, state.stage);
  look(0.6, 0.8, 0.25);
  window.mantleView = { head, state, show, pick, look, meshes, largest };
  box.dataset.ready = "yes";
})();
