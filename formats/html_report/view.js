"use strict";
// The 3D view of the report: a small software renderer with a depth buffer, drawn into a canvas. It needs no WebGL, no
// library and no network, and looks the same everywhere. Data: see view_data.py.
(() => {
  const data = JSON.parse(document.getElementById("view-data").textContent);
  const canvas = document.getElementById("canvas");
  const context = canvas.getContext("2d");
  const slider = document.getElementById("time");
  const clock = document.getElementById("clock");
  const playButton = document.getElementById("play");
  const toolsBox = document.getElementById("tools");
  document.getElementById("view").hidden = false;

  const STOPS = [[221, 225, 230], [253, 227, 167], [249, 166, 74], [228, 87, 46], [179, 20, 47], [92, 10, 51]];
  const RAMP = new Uint8Array(256 * 3);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (STOPS.length - 1), n = Math.min(Math.floor(at), STOPS.length - 2);
    for (let k = 0; k < 3; k++) RAMP[3 * i + k] = Math.round(STOPS[n][k] + (at - n) * (STOPS[n + 1][k] - STOPS[n][k]));
  }

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const u32 = (text) => new Uint32Array(bytes(text).buffer);
  const u16 = (text) => new Uint16Array(bytes(text).buffer);

  // ------------------------------------------------------------------ meshes
  const meshes = data.meshes.map((packed) => ({
    kind: packed.kind,
    count: packed.count,
    triangles: u32(packed.triangles),
    lines: u32(packed.lines),
    moving: u32(packed.moving),
    frames: packed.frames.map(u16),
    colours: packed.colours.map(bytes),
    steps: u16(packed.rest),
    points: new Float32Array(packed.count * 3),
    normals: new Float32Array(packed.count * 3),
    shade: new Uint8Array(packed.count),
    screen: new Float32Array(packed.count * 3), // x, y in pixels, 1 / distance
    rgb: new Float32Array(packed.count * 3),
    shown: -1,
  }));

  function setFrame(mesh, frame) {
    const n = Math.min(frame, Math.max(mesh.frames.length - 1, 0));
    if (mesh.shown === n) return;
    mesh.shown = n;
    if (mesh.frames.length) {
      const from = mesh.frames[n];
      for (let i = 0; i < mesh.moving.length; i++) {
        const v = 3 * mesh.moving[i];
        mesh.steps[v] = from[3 * i];
        mesh.steps[v + 1] = from[3 * i + 1];
        mesh.steps[v + 2] = from[3 * i + 2];
      }
      if (mesh.colours.length) for (let i = 0; i < mesh.moving.length; i++) mesh.shade[mesh.moving[i]] = mesh.colours[n][i];
    }
    const { points, normals, steps, triangles } = mesh;
    for (let i = 0; i < points.length; i++) points[i] = steps[i] * data.scale;
    normals.fill(0);
    for (let t = 0; t < triangles.length; t += 3) {
      const a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
      const ux = points[b] - points[a], uy = points[b + 1] - points[a + 1], uz = points[b + 2] - points[a + 2];
      const vx = points[c] - points[a], vy = points[c + 1] - points[a + 1], vz = points[c + 2] - points[a + 2];
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      for (const v of [a, b, c]) {
        normals[v] += nx;
        normals[v + 1] += ny;
        normals[v + 2] += nz;
      }
    }
    for (let v = 0; v < normals.length; v += 3) {
      const length = Math.hypot(normals[v], normals[v + 1], normals[v + 2]) || 1;
      normals[v] /= length;
      normals[v + 1] /= length;
      normals[v + 2] /= length;
    }
  }

  // ------------------------------------------------------------------ camera: turns about z, in perspective
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const solid = meshes.some((mesh) => mesh.kind !== "tool") ? meshes.filter((mesh) => mesh.kind !== "tool") : meshes;
  for (const mesh of solid)
    for (let i = 0; i < mesh.steps.length; i++) {
      low[i % 3] = Math.min(low[i % 3], mesh.steps[i] * data.scale);
      high[i % 3] = Math.max(high[i % 3], mesh.steps[i] * data.scale);
    }
  const middle = low.map((value, k) => 0.5 * (value + high[k]));
  const radius = 0.5 * Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]) || 1;
  const HALF_ANGLE = 0.21;
  let camera;
  function resetCamera() {
    const [x, y, z] = data.camera;
    camera = { yaw: Math.atan2(y, x), pitch: Math.asin(Math.max(-1, Math.min(1, z))), zoom: 0.86, target: middle.slice() };
  }
  resetCamera();

  function axes() {
    const cp = Math.cos(camera.pitch), sp = Math.sin(camera.pitch), cy = Math.cos(camera.yaw), sy = Math.sin(camera.yaw);
    return { back: [cp * cy, cp * sy, sp], right: [-sy, cy, 0], up: [-sp * cy, -sp * sy, cp] };
  }

  // ------------------------------------------------------------------ drawing
  let width = 0, height = 0, image, pixels, depth, layer, layerDepth;
  const LIGHTS = [[-0.45, 0.55, 0.7, 0.62], [0.35, -0.35, 0.87, 0.38]]; // right, up, towards the viewer, strength

  function resize(scale) {
    const w = Math.max(1, Math.round(canvas.clientWidth * scale)), h = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (w === width && h === height) return;
    width = canvas.width = w;
    height = canvas.height = h;
    image = context.createImageData(w, h);
    pixels = new Uint32Array(image.data.buffer);
    depth = new Float32Array(w * h);
    layer = new Uint32Array(w * h);
    layerDepth = new Float32Array(w * h);
  }

  const styleRgb = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).split(",").map(Number);

  function project(mesh, look, face) {
    const { back, right, up } = look;
    const distance = (radius / Math.sin(HALF_ANGLE)) * camera.zoom;
    const focal = (0.5 * Math.min(height, width / 1.25)) / Math.tan(HALF_ANGLE);
    const { points, normals, screen, rgb, shade } = mesh;
    const [tx, ty, tz] = camera.target;
    for (let v = 0, i = 0; v < points.length; v += 3, i++) {
      const x = points[v] - tx, y = points[v + 1] - ty, z = points[v + 2] - tz;
      const away = distance - (x * back[0] + y * back[1] + z * back[2]);
      const inverse = away > 1e-6 * radius ? 1 / away : 0; // 0: behind the camera, not drawn
      screen[v] = width / 2 + focal * inverse * (x * right[0] + y * right[1] + z * right[2]);
      screen[v + 1] = height / 2 - focal * inverse * (x * up[0] + y * up[1] + z * up[2]);
      screen[v + 2] = inverse;
      let nr = normals[v] * right[0] + normals[v + 1] * right[1] + normals[v + 2] * right[2];
      let nu = normals[v] * up[0] + normals[v + 1] * up[1] + normals[v + 2] * up[2];
      let nb = normals[v] * back[0] + normals[v + 1] * back[1] + normals[v + 2] * back[2];
      const side = nb < 0 ? -1 : 1; // both sides of a face are lit
      nr *= side; nu *= side; nb *= side;
      let light = 0.24;
      for (const [r, u, b, strength] of LIGHTS) light += strength * Math.max(0, nr * r + nu * u + nb * b);
      const c = 3 * shade[i];
      rgb[v] = Math.min(255, light * (face ? face[0] : RAMP[c]));
      rgb[v + 1] = Math.min(255, light * (face ? face[1] : RAMP[c + 1]));
      rgb[v + 2] = Math.min(255, light * (face ? face[2] : RAMP[c + 2]));
    }
  }

  function fill(mesh, target, nearest) {
    const { triangles, screen, rgb } = mesh;
    for (let t = 0; t < triangles.length; t += 3) {
      const a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
      const za = screen[a + 2], zb = screen[b + 2], zc = screen[c + 2];
      if (za <= 0 || zb <= 0 || zc <= 0) continue;
      const ax = screen[a], ay = screen[a + 1], bx = screen[b], by = screen[b + 1], cx = screen[c], cy = screen[c + 1];
      const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
      if (area === 0) continue;
      const x0 = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), x1 = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5));
      const y0 = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), y1 = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
      if (x0 > x1 || y0 > y1) continue;
      // barycentric weights of b and c are linear in x and y
      const ub = (cy - ay) / area, vb = -(cx - ax) / area, uc = -(by - ay) / area, vc = (bx - ax) / area;
      for (let y = y0; y <= y1; y++) {
        const dy = y + 0.5 - ay;
        for (let x = x0; x <= x1; x++) {
          const dx = x + 0.5 - ax;
          const wb = ub * dx + vb * dy, wc = uc * dx + vc * dy, wa = 1 - wb - wc;
          if (wa < -1e-6 || wb < -1e-6 || wc < -1e-6) continue;
          const z = wa * za + wb * zb + wc * zc, p = y * width + x;
          if (z <= nearest[p] || z < depth[p]) continue;
          nearest[p] = z;
          const red = wa * rgb[a] + wb * rgb[b] + wc * rgb[c];
          const green = wa * rgb[a + 1] + wb * rgb[b + 1] + wc * rgb[c + 1];
          const blue = wa * rgb[a + 2] + wb * rgb[b + 2] + wc * rgb[c + 2];
          target[p] = 0xff000000 | (blue << 16) | (green << 8) | red;
        }
      }
    }
  }

  function stroke(mesh, colour, thick) {
    const { lines, screen } = mesh;
    const ink = 0xff000000 | (colour[2] << 16) | (colour[1] << 8) | colour[0];
    for (let l = 0; l < lines.length; l += 2) {
      const a = 3 * lines[l], b = 3 * lines[l + 1];
      const za = screen[a + 2], zb = screen[b + 2];
      if (za <= 0 || zb <= 0) continue;
      const dx = screen[b] - screen[a], dy = screen[b + 1] - screen[a + 1];
      const count = Math.min(4096, Math.max(1, Math.ceil(Math.max(Math.abs(dx), Math.abs(dy)))));
      for (let n = 0; n <= count; n++) {
        const s = n / count, z = (za + s * (zb - za)) * 1.0015; // a little nearer, so that faces do not hide their edges
        const px = Math.round(screen[a] + s * dx - 0.5 * thick), py = Math.round(screen[a + 1] + s * dy - 0.5 * thick);
        for (let j = py; j < py + thick; j++)
          for (let i = px; i < px + thick; i++)
            if (i >= 0 && j >= 0 && i < width && j < height && z >= depth[j * width + i]) pixels[j * width + i] = ink;
      }
    }
  }

  function blend(alpha) {
    for (let p = 0; p < layer.length; p++) {
      if (layerDepth[p] === 0) continue;
      const over = layer[p], under = pixels[p], covered = (under >>> 24) / 255;
      const out = alpha + covered * (1 - alpha);
      const mix = (shift) => (alpha * ((over >>> shift) & 255) + (1 - alpha) * covered * ((under >>> shift) & 255)) / out;
      pixels[p] = (Math.round(out * 255) << 24) | (mix(16) << 16) | (mix(8) << 8) | mix(0);
    }
  }

  let frame = 0;
  function render(scale) {
    resize(scale);
    pixels.fill(0);
    depth.fill(0);
    const look = axes(), part = styleRgb("--part"), edge = styleRgb("--edge");
    for (const mesh of meshes) {
      if (mesh.kind === "tool") continue;
      setFrame(mesh, frame);
      project(mesh, look, mesh.kind === "face" ? part : null);
      fill(mesh, pixels, depth);
    }
    for (const mesh of meshes) if (mesh.kind !== "tool") stroke(mesh, edge, Math.max(1, Math.round(scale)));
    if (toolsBox.checked && meshes.some((mesh) => mesh.kind === "tool")) {
      layerDepth.fill(0);
      for (const mesh of meshes) {
        if (mesh.kind !== "tool") continue;
        setFrame(mesh, frame);
        project(mesh, look, [70, 130, 200]);
        fill(mesh, layer, layerDepth);
      }
      blend(0.42);
    }
    context.putImageData(image, 0, 0);
  }

  // Draft while something moves, then once more with finer pixels.
  let waiting = 0, settle = 0;
  const dots = () => Math.min(window.devicePixelRatio || 1, 2);
  function draw() {
    if (!waiting)
      waiting = requestAnimationFrame(() => {
        waiting = 0;
        render(1);
      });
    clearTimeout(settle);
    settle = setTimeout(() => render(Math.max(2, dots())), 140);
  }

  // ------------------------------------------------------------------ controls
  const last = data.times.length - 1;
  slider.max = String(Math.max(last, 0));
  function show(n) {
    frame = n;
    slider.value = String(n);
    clock.textContent = data.times.length ? `${data.times[n].toFixed(3)} s` : "";
    draw();
  }
  let playing = 0;
  function stop() {
    clearInterval(playing);
    playing = 0;
    playButton.textContent = "▶";
    playButton.setAttribute("aria-label", "play");
  }
  playButton.addEventListener("click", () => {
    if (playing) return stop();
    if (frame >= last) show(0);
    playButton.textContent = "❚❚";
    playButton.setAttribute("aria-label", "pause");
    playing = setInterval(() => (frame < last ? show(frame + 1) : stop()), 70);
    return undefined;
  });
  slider.addEventListener("input", () => {
    stop();
    show(Number(slider.value));
  });
  toolsBox.addEventListener("change", draw);
  toolsBox.closest("label").hidden = !meshes.some((mesh) => mesh.kind === "tool");
  document.getElementById("reset").addEventListener("click", () => {
    resetCamera();
    draw();
  });
  if (last < 1) for (const element of [slider, playButton]) element.hidden = true;

  function turn(dx, dy) {
    camera.yaw -= dx * 0.008;
    camera.pitch = Math.max(-1.55, Math.min(1.55, camera.pitch + dy * 0.008));
    draw();
  }
  function shift(dx, dy) {
    const { right, up } = axes(), step = (2.2 * radius * camera.zoom) / canvas.clientHeight;
    for (let k = 0; k < 3; k++) camera.target[k] += step * (dy * up[k] - dx * right[k]);
    draw();
  }
  function zoom(factor) {
    camera.zoom = Math.max(0.02, Math.min(6, camera.zoom * factor));
    draw();
  }
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"])
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before[0], dy = event.clientY - before[1];
    if (pointers.size === 2) {
      const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]);
      const now = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
      if (was > 0 && now > 0) zoom(was / now);
      shift(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) shift(dx, dy);
    else turn(dx, dy);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp(Math.max(-120, Math.min(120, event.deltaY)) * 0.0016));
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] }[event.key];
    if (step) turn(...step);
    else if (event.key === "+") zoom(0.9);
    else if (event.key === "-") zoom(1.1);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(draw).observe(canvas);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  window.addEventListener("beforeprint", () => render(2));

  // ------------------------------------------------------------------ legend
  const css = STOPS.map((stop) => `rgb(${stop})`).join(", ");
  document.querySelector("#scale i").style.background = `linear-gradient(to right, ${css})`;
  document.getElementById("scale-title").textContent = `Displacement along the normal [${data.units}]`;
  document.getElementById("scale-top").textContent = String(Number(data.top.toPrecision(3)));
  document.getElementById("scale").hidden = !(data.top > 0);
  show(last > 0 ? last : 0);
})();
