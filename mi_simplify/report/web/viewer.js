"use strict";
// The models in 3D: WebGL 2, a light over the viewer's shoulder and a dim sky, the material of the program's ggx_gamma.
(() => {
  const box = document.getElementById("viewer");
  if (!box) return;
  const canvas = box.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
  if (!gl || !window.DecompressionStream) {
    box.dataset.state = "none";
    return;
  }
  const data = JSON.parse(document.getElementById("viewer-data").textContent);

  const VERTEX = `#version 300 es
    uniform mat4 toClip; uniform bool posed; uniform highp sampler2D pose;
    layout(location = 0) in vec3 position;
    layout(location = 1) in vec4 normal;
    layout(location = 2) in vec4 tangent;
    layout(location = 3) in vec2 uv;
    layout(location = 4) in vec4 color;
    layout(location = 5) in vec4 joints;
    layout(location = 6) in vec4 weights;
    layout(location = 7) in vec4 joints2;
    layout(location = 8) in vec4 weights2;
    out vec3 p; out vec3 n; out vec4 t; out vec2 st; out vec3 tint;
    vec4 row(int r) { // of the blend of the joints' matrices
      vec4 sum = vec4(0);
      for (int k = 0; k < 4; k++) {
        if (weights[k] > 0.0) sum += weights[k] * texelFetch(pose, ivec2(r, int(joints[k])), 0);
        if (weights2[k] > 0.0) sum += weights2[k] * texelFetch(pose, ivec2(r, int(joints2[k])), 0);
      }
      return sum;
    }
    void main() {
      p = position; n = normal.xyz; t = tangent; st = uv;
      if (posed) {
        vec4 x = row(0), y = row(1), z = row(2), v = vec4(position, 1.0);
        p = vec3(dot(x, v), dot(y, v), dot(z, v));
        t.xyz = vec3(dot(x.xyz, t.xyz), dot(y.xyz, t.xyz), dot(z.xyz, t.xyz));
        n = vec3(dot(cross(y.xyz, z.xyz), n), dot(cross(z.xyz, x.xyz), n), dot(cross(x.xyz, y.xyz), n));
      }
      tint = pow(color.rgb, vec3(2.2));
      gl_Position = toClip * vec4(p, 1.0);
    }`;

  // Trowbridge-Reitz with the height-correlated Smith term, Schlick's Fresnel, roughness squared; gamma scales the lobe.
  // The sky's share of the lobe is Karis's fit ("Physically Based Shading on Mobile", 2014).
  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform vec3 eye, light; uniform int mode; uniform float cutoff; uniform bool blend;
    uniform sampler2D base_color, opacity, gamma, roughness, metallic, normal;
    in vec3 p; in vec3 n; in vec4 t; in vec2 st; in vec3 tint;
    out vec4 result;
    vec3 sky(float up, float blur) { return vec3(mix(0.06, 0.42, smoothstep(-0.2 - blur, 0.5 + blur, up))); }
    void main() {
      float alpha = texture(opacity, st).r;
      if (cutoff > 0.0 && alpha < cutoff) discard;
      vec3 kd = texture(base_color, st).rgb * tint;
      float m = texture(metallic, st).r, rough = max(texture(roughness, st).r, 0.05);
      vec3 map = texture(normal, st).xyz * 2.0 - 1.0;
      vec3 v = normalize(eye - p), ng = normalize(n), u = normalize(t.xyz - ng * dot(ng, t.xyz));
      float side = gl_FrontFacing ? 1.0 : -1.0;
      if (mode == 5) map = vec3(0, 0, 1);
      vec3 s = side * normalize(map.x * u + map.y * t.w * cross(ng, u) + map.z * ng);
      if (mode == 5) { kd = vec3(0.5); m = 0.0; rough = 0.5; }
      float nv = max(dot(s, v), 0.02), nl = max(dot(s, light), 0.0);
      vec3 h = normalize(light + v);
      float nh = max(dot(s, h), 0.0), vh = max(dot(v, h), 0.0), a = rough * rough, a2 = a * a;
      vec3 f0 = mix(vec3(0.04), kd, m) * (1.0 - texture(gamma, st).r);
      vec3 f = f0 + (1.0 - f0) * pow(1.0 - vh, 5.0);
      float d = a2 / (3.14159265 * pow(nh * nh * (a2 - 1.0) + 1.0, 2.0));
      float g = 0.5 / max(nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2), 1e-4);
      vec3 diffuse = kd * (1.0 - m);
      vec3 color = nl * 2.5 * (diffuse * (1.0 - f) / 3.14159265 + f * d * g);
      vec4 r = rough * vec4(-1, -0.0275, -0.572, 0.022) + vec4(1, 0.0425, 1.04, -0.04);
      vec2 ab = vec2(-1.04, 1.04) * (min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y) + r.zw;
      color += diffuse * sky(s.y, 0.8) + (f0 * ab.x + ab.y) * sky(reflect(-v, s).y, rough);
      if (mode == 1) color = kd;
      color = pow(clamp(color, 0.0, 1.0), vec3(1.0 / 2.2));
      if (mode == 2) color = vec3(texture(roughness, st).r);
      if (mode == 3) color = vec3(m);
      if (mode == 4) color = s * 0.5 + 0.5;
      if (mode == 6) color = vec3(0.05, 0.9, 0.55);
      result = vec4(color, blend && mode != 6 ? alpha : 1.0);
    }`;

  const program = webgl.program(gl, VERTEX, FRAGMENT);
  const at = (name) => gl.getUniformLocation(program, name);
  const uniforms = Object.fromEntries(["toClip", "eye", "light", "mode", "cutoff", "blend", "posed"].map((k) => [k, at(k)]));
  const UNITS = ["base_color", "opacity", "gamma", "roughness", "metallic", "normal"];
  const DEFAULTS = { opacity: [255, 255, 255], gamma: [0, 0, 0], normal: [128, 128, 255] };
  [...UNITS, "pose"].forEach((name, unit) => gl.uniform1i(at(name), unit));
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);

  function texture(name, source) {
    const target = gl.createTexture();
    const format = name === "base_color" ? gl.SRGB8_ALPHA8 : gl.RGBA8;
    const fill = (...content) => {
      gl.bindTexture(gl.TEXTURE_2D, target);
      gl.texImage2D(gl.TEXTURE_2D, 0, format, ...content);
      gl.generateMipmap(gl.TEXTURE_2D);
    };
    gl.activeTexture(gl.TEXTURE0);
    fill(1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([...(DEFAULTS[name] || [128, 128, 128]), 255]));
    if (source) {
      const image = source.startsWith("#") ? document.querySelector(source) : Object.assign(new Image(), { src: source });
      loading += 1;
      image.decode().then(() => {
        gl.activeTexture(gl.TEXTURE0);
        fill(gl.RGBA, gl.UNSIGNED_BYTE, image);
        loading -= 1;
        changed = true;
      });
    }
    return target;
  }

  // [attribute, components, type, normalised]
  const ATTRIBUTES = [
    ["positions", 3, gl.FLOAT, false], ["normals", 4, gl.SHORT, true], ["tangents", 4, gl.SHORT, true],
    ["uvs", 2, gl.FLOAT, false], ["colors", 4, gl.UNSIGNED_BYTE, true],
    ["joints", 4, gl.UNSIGNED_SHORT, false], ["weights", 4, gl.UNSIGNED_SHORT, true],
    ["joints2", 4, gl.UNSIGNED_SHORT, false], ["weights2", 4, gl.UNSIGNED_SHORT, true],
  ];
  async function upload(part) {
    const names = [...ATTRIBUTES.map(([name]) => name), "indices"].filter((name) => part[name]);
    const content = await Promise.all(names.map((name) => webgl.unpacked(part[name])));
    const arrays = Object.fromEntries(names.map((name, k) => [name, content[k]]));
    const vertices = gl.createVertexArray();
    gl.bindVertexArray(vertices);
    ATTRIBUTES.forEach(([name, size, type, normalised], location) => {
      if (!part[name]) return;
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, arrays[name], gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, type, normalised, 0, 0);
    });
    const triangles = new Uint32Array(new (part.vertices <= 65535 ? Uint16Array : Uint32Array)(arrays.indices));
    const lines = new Uint32Array(2 * triangles.length);
    triangles.forEach((vertex, k) => {
      lines[2 * k] = vertex;
      lines[2 * k + 1] = triangles[k % 3 === 2 ? k - 2 : k + 1];
    });
    const buffer = (list) => {
      const made = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, made);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, list, gl.STATIC_DRAW);
      return { buffer: made, n: list.length };
    };
    const textures = UNITS.map((name) => texture(name, part.textures[name]));
    return { vertices, faces: buffer(triangles), edges: buffer(lines), textures, cutoff: part.cutoff, blend: part.blend };
  }
  async function load(model) {
    loading += 1;
    uploaded.set(model, []);
    const moves = data.clip && data.clip.joints[model];
    if (moves) matrices.set(model, new Float32Array(await webgl.unpacked(moves)));
    uploaded.set(model, await Promise.all(data.models[model].parts.map(upload)));
    loading -= 1;
    changed = true;
  }

  let loading = 0, changed = true, visible = true;
  const uploaded = new Map(); // models are uploaded when they are first looked at
  const matrices = new Map(); // of the joints of those that move: three rows each, frame after frame
  const pose = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, pose);
  for (const way of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, way, gl.NEAREST);
  const START = { yaw: 0.6, pitch: 0.3, distance: 2.6 };
  const camera = { ...START }, lamp = { yaw: -0.55, pitch: 0.55 };
  let turning = !matchMedia("(prefers-reduced-motion: reduce)").matches;

  const [modelPicker, modePicker, wires] = ["model", "mode", "wires"].map((k) => box.querySelector(`[name=${k}]`));
  const direction = (yaw, pitch) => [Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a.reduce((sum, x, k) => sum + x * b[k], 0);

  function draw() {
    const width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
    const height = Math.max(1, Math.round(canvas.clientHeight * devicePixelRatio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.085, 0.088, 0.1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);

    const z = direction(camera.yaw, camera.pitch), x = [Math.cos(camera.yaw), 0, -Math.sin(camera.yaw)], y = cross(z, x);
    const distance = camera.distance * Math.max(1, height / width); // the model fills a sphere of radius 1
    const eye = z.map((v) => distance * v);
    const f = 1 / Math.tan(0.36), near = Math.max(0.01, distance - 1.5), far = distance + 1.5;
    const [a, b] = [(far + near) / (far - near), (-2 * far * near) / (far - near)];
    const rows = [x.map((v) => (v * f * height) / width), y.map((v) => v * f), z.map((v) => -v)];
    const [cx, cy, cw] = rows.map((row) => -dot(row, eye));
    const [rx, ry, rw] = rows; // w is the depth in front of the eye, z / w goes from -1 to 1
    const toClip = [0, 1, 2].flatMap((k) => [rx[k], ry[k], a * rw[k], rw[k]]).concat([cx, cy, a * cw + b, cw]);
    gl.uniformMatrix4fv(uniforms.toClip, false, toClip);
    gl.uniform3fv(uniforms.eye, eye);
    const l = direction(lamp.yaw, lamp.pitch);
    gl.uniform3fv(uniforms.light, [0, 1, 2].map((k) => l[0] * x[k] + l[1] * y[k] + l[2] * z[k]));

    const chosen = Number(modelPicker.value);
    if (!uploaded.has(chosen)) load(chosen);
    gl.vertexAttrib4f(4, 1, 1, 1, 1);
    for (const location of [5, 6, 7, 8]) gl.vertexAttrib4f(location, 0, 0, 0, 0);
    const moves = matrices.get(chosen);
    gl.uniform1i(uniforms.posed, Boolean(moves));
    if (moves) {
      const n = moves.length / data.clip.seconds.length; // numbers a frame
      gl.activeTexture(gl.TEXTURE0 + UNITS.length);
      gl.bindTexture(gl.TEXTURE_2D, pose);
      const rows = moves.subarray(n * Number(slider.value), n * (Number(slider.value) + 1));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 3, n / 12, 0, gl.RGBA, gl.FLOAT, rows);
    }
    for (const part of uploaded.get(chosen)) {
      gl.bindVertexArray(part.vertices);
      part.textures.forEach((t, unit) => {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, t);
      });
      gl.uniform1f(uniforms.cutoff, part.cutoff);
      gl.uniform1i(uniforms.blend, part.blend);
      const pass = (what, kind, mode) => {
        gl.uniform1i(uniforms.mode, mode);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, what.buffer);
        gl.drawElements(kind, what.n, gl.UNSIGNED_INT, 0);
      };
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
      pass(part.faces, gl.TRIANGLES, Number(modePicker.value));
      if (wires.checked) pass(part.edges, gl.LINES, 6);
    }
    box.dataset.state = loading ? "loading" : "drawn";
  }

  // The clip: what is chosen of it, from one frame to the next by its own seconds.
  const [play, clipPicker, slider] = ["play", "clip", "frame"].map((k) => box.querySelector(`[name=${k}]`));
  let clock = 0;
  function tell() {
    const first = Number(slider.min);
    const [k, n] = [Number(slider.value) - first + 1, Number(slider.max) - first + 1];
    const seconds = data.clip.seconds[slider.value] - data.clip.seconds[first];
    box.querySelector("output").textContent = `${k} of ${n}, ${seconds.toFixed(2)} s`;
    box.dataset.frame = slider.value;
    changed = true;
  }
  function advance(passed) {
    const at = Number(slider.value), end = Number(slider.max);
    const long = at < end ? data.clip.seconds[at + 1] - data.clip.seconds[at] : 0;
    clock += passed;
    if (clock < long) return;
    clock = Math.min(clock - long, 0.1);
    slider.value = at < end ? at + 1 : slider.min;
    tell();
  }
  if (data.clip) {
    play.checked = turning;
    slider.addEventListener("input", () => {
      play.checked = false;
      tell();
    });
    clipPicker.addEventListener("change", () => {
      const [, first, end] = data.clip.clips[clipPicker.value];
      Object.assign(slider, { min: first, max: end - 1 });
      slider.value = first;
      tell();
    });
    tell();
  }

  let last = 0;
  function frame(now) {
    if (visible && play?.checked) advance(Math.min(0.1, (now - last) / 1000));
    if (turning && visible) {
      camera.yaw += 0.35 * Math.min(0.1, (now - last) / 1000);
      changed = true;
    }
    last = now;
    if (changed && visible) {
      changed = false;
      draw();
    }
    requestAnimationFrame(frame);
  }

  const touched = () => {
    turning = false;
    changed = true;
  };
  const clamp = (v, least, most) => Math.min(most, Math.max(least, v));
  const zoom = (factor) => {
    camera.distance = clamp(camera.distance * factor, 0.4, 12);
    touched();
  };
  const orbit = (object, yaw, pitch) => {
    object.yaw += yaw;
    object.pitch = clamp(object.pitch + pitch, -1.55, 1.55);
    touched();
  };
  const pointers = new Map();
  const spread = () => {
    const [p, q] = pointers.values();
    return Math.hypot(p.x - q.x, p.y - q.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    touched();
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const apart = pointers.size === 2 ? spread() : 0;
    const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (apart) zoom(apart / Math.max(1, spread()));
    else if (event.shiftKey || event.buttons & 2) orbit(lamp, 0.008 * dx, -0.008 * dy);
    else orbit(camera, -0.008 * dx, 0.008 * dy);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => pointers.delete(e.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(clamp(event.deltaY, -200, 200) * 0.0015));
  }, { passive: false });
  canvas.addEventListener("dblclick", () => {
    Object.assign(camera, START);
    touched();
  });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (step) orbit(camera, ...step);
    else if (event.key === "+" || event.key === "=") zoom(0.9);
    else if (event.key === "-") zoom(1 / 0.9);
    else return;
    event.preventDefault();
  });
  for (const control of [modelPicker, modePicker, wires]) control.addEventListener("change", () => (changed = true));
  new ResizeObserver(() => (changed = true)).observe(canvas);
  new IntersectionObserver(([entry]) => {
    visible = entry.isIntersecting;
    changed = true;
  }).observe(canvas);
  requestAnimationFrame(frame);
})();
