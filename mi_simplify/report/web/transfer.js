"use strict";
// Frames of surfaces side by side, one view a set of coefficients: times light they are a color for each vertex or texel,
// drawn by WebGL 2.
(() => {
  const box = document.getElementById("player");
  const canvas = box.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
  if (!gl || !window.DecompressionStream) {
    box.dataset.state = "none";
    return;
  }
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const [sky, turn, frame, play, spin] = ["sky", "turn", "frame", "play", "spin"].map((k) => box.querySelector(`[name=${k}]`));
  const k = data.coefficients, nViews = data.names.length;

  const VERTEX = `#version 300 es
    uniform mat4 toClip;
    layout(location = 0) in vec3 position;
    layout(location = 1) in vec3 radiance;
    layout(location = 2) in vec2 uv;
    out vec3 color; out vec2 at;
    void main() { color = radiance; at = uv; gl_Position = toClip * vec4(position, 1.0); }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform sampler2D map; uniform bool textured;
    in vec3 color; in vec2 at; out vec4 result;
    void main() {
      vec3 c = textured ? texture(map, at).rgb : color;
      c = gl_FrontFacing ? clamp(c, 0.0, 1.0) : vec3(0.0);
      result = vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)), 1.0);
    }`;
  const program = webgl.program(gl, VERTEX, FRAGMENT);
  const toClip = gl.getUniformLocation(program, "toClip"), textured = gl.getUniformLocation(program, "textured");

  // The sky turned by an angle: a Fourier series, (K, 3).
  function light() {
    const series = data.skies[sky.value], a = (turn.value * Math.PI) / 180;
    const terms = series.map((_, j) => (j ? (j % 2 ? Math.cos : Math.sin)(Math.ceil(j / 2) * a) : 1));
    return series[0].map((row, i) => row.map((_, c) => terms.reduce((sum, t, j) => sum + t * series[j][i][c], 0)));
  }

  let surfaces, changed = true, last = 0, clock = 0;
  const camera = { yaw: (data.view[0] * Math.PI) / 180, pitch: (data.view[1] * Math.PI) / 180, distance: 3.2 };

  function pose(surface, at) {
    const { points, positions, size, buffers } = surface, start = points.length * at;
    for (let i = 0; i < points.length; i++) points[i] = (positions[start + i] * size) / 32767;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
  }

  // Colors of the vertices, or of the texels as sRGB bytes, which are filtered as what they stand for.
  const encode = (c) => 255 * (c > 0.0031308 ? 1.055 * Math.min(c, 1) ** (1 / 2.4) - 0.055 : 12.92 * Math.max(c, 0));
  function shade(surface, values, at, l) {
    const { side, colors, bytes, buffers, map } = surface, n = colors.length / 3;
    const start = k * n * at, scale = data.scale / 32767;
    for (let v = 0; v < n; v++) {
      let r = 0, g = 0, b = 0;
      for (let i = 0; i < k; i++) {
        const t = values[start + v * k + i];
        r += t * l[i][0];
        g += t * l[i][1];
        b += t * l[i][2];
      }
      colors[3 * v] = r * scale;
      colors[3 * v + 1] = g * scale;
      colors[3 * v + 2] = b * scale;
    }
    if (side) {
      for (let v = 0; v < n; v++) for (let c = 0; c < 3; c++) bytes[4 * v + c] = encode(colors[3 * v + c]);
      gl.bindTexture(gl.TEXTURE_2D, map);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, side, side, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    } else {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[1]);
      gl.bufferData(gl.ARRAY_BUFFER, colors, gl.DYNAMIC_DRAW);
    }
    gl.uniform1i(textured, Boolean(side));
  }

  // The arrays of a surface on the device.
  function placed(surface, [faces, positions, uvs, ...views]) {
    const side = surface.side, n = side * side || surface.vertices;
    const indices = new Uint32Array(faces), vao = gl.createVertexArray(), map = gl.createTexture();
    gl.bindVertexArray(vao);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    const buffers = [0, 1, 2].map((location) => {
      const buffer = gl.createBuffer();
      if (location === (side ? 1 : 2)) return buffer;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      if (location === 2) gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(uvs), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, location === 2 ? 2 : 3, gl.FLOAT, false, 0, 0);
      return buffer;
    });
    gl.bindTexture(gl.TEXTURE_2D, map);
    for (const axis of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, axis, gl.CLAMP_TO_EDGE);
    for (const way of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, way, gl.LINEAR);
    return {
      vao, map, buffers, side, size: surface.size, nIndices: indices.length, positions: new Int16Array(positions),
      points: new Float32Array(3 * surface.vertices), colors: new Float32Array(3 * n),
      bytes: new Uint8Array(4 * side * side).fill(255), views: views.map((view) => new Int16Array(view)),
    };
  }

  const dot = (a, b) => a.reduce((sum, x, j) => sum + x * b[j], 0);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  function matrix() {
    const { yaw, pitch, distance } = camera;
    const z = [Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)];
    const x = [Math.cos(yaw), 0, -Math.sin(yaw)], y = cross(z, x), eye = z.map((v) => distance * v);
    const f = 1 / Math.tan(0.36), near = Math.max(0.01, distance - 3), far = distance + 3;
    const [a, b] = [(far + near) / (far - near), (-2 * far * near) / (far - near)];
    const [rx, ry, rw] = [x.map((v) => v * f), y.map((v) => v * f), z.map((v) => -v)];
    const [cx, cy, cw] = [rx, ry, rw].map((row) => -dot(row, eye));
    return [0, 1, 2].flatMap((j) => [rx[j], ry[j], a * rw[j], rw[j]]).concat([cx, cy, a * cw + b, cw]);
  }

  function draw() {
    const width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
    const height = Math.max(1, Math.round(canvas.clientHeight * devicePixelRatio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.clearColor(0.085, 0.088, 0.1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(toClip, false, matrix());
    const at = Number(frame.value), l = light(), side = Math.min(height, Math.floor(width / nViews));
    let j = 0;
    for (const surface of surfaces) {
      gl.bindVertexArray(surface.vao);
      pose(surface, at);
      for (const view of surface.views) {
        shade(surface, view, at, l);
        gl.viewport(Math.round((width * (j++ + 0.5)) / nViews - side / 2), Math.round((height - side) / 2), side, side);
        gl.drawElements(gl.TRIANGLES, surface.nIndices, gl.UNSIGNED_INT, 0);
      }
    }
    box.dataset.state = "drawn";
  }

  function tick(now) {
    const passed = Math.min(0.1, (now - last) / 1000);
    last = now;
    if (spin.checked) {
      turn.value = (Number(turn.value) + 60 * passed) % 360;
      changed = true;
    }
    if (play.checked && (clock += passed) > 0.1) {
      clock = 0;
      frame.value = (Number(frame.value) + 1) % data.frames;
      changed = true;
    }
    if (changed) {
      changed = false;
      draw();
    }
    requestAnimationFrame(tick);
  }

  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held = [event.clientX, event.clientY];
  });
  const orbit = (yaw, pitch) => {
    camera.yaw += yaw;
    camera.pitch = Math.min(1.55, Math.max(-1.55, camera.pitch + pitch));
    changed = true;
  };
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    orbit(-0.008 * (event.clientX - held[0]), 0.008 * (event.clientY - held[1]));
    held = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (held = null));
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!step) return;
    orbit(...step);
    event.preventDefault();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.distance = Math.min(12, Math.max(0.6, camera.distance * Math.exp(event.deltaY * 0.0015)));
    changed = true;
  }, { passive: false });
  for (const control of [sky, turn, frame]) control.addEventListener("input", () => (changed = true));
  new ResizeObserver(() => (changed = true)).observe(canvas);

  (async () => {
    surfaces = [];
    for (const surface of data.surfaces) {
      const parts = [surface.faces, surface.positions, surface.uvs, ...Object.values(surface.views)];
      surfaces.push(placed(surface, await Promise.all(parts.map(webgl.unpacked))));
    }
    play.checked = spin.checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    requestAnimationFrame(tick);
  })();
})();
