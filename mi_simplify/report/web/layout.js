"use strict";
// The UV layout over the textures: edges of triangles, those on borders of charts bold, as one picture a material.
(() => {
  const toggle = document.getElementById("layout");
  if (!toggle || !window.DecompressionStream) {
    toggle?.closest("label").remove();
    return;
  }
  const made = new Map();

  // Edges as a path in hundredths of a percent, those of one triangle only apart from the others.
  function paths(uvs, triangles) {
    const places = new Map(); // vertices may differ in their normals only
    const place = Int32Array.from({ length: uvs.length / 2 }, (_, v) => {
      const key = `${uvs[2 * v]},${uvs[2 * v + 1]}`;
      if (!places.has(key)) places.set(key, v);
      return places.get(key);
    });
    const edges = new Map(), n = place.length;
    for (let k = 0; k < triangles.length; k += 3) {
      const corners = [0, 1, 2].map((i) => place[triangles[k + i]]);
      const [left, top] = [0, 1].map((axis) => // coordinates that repeat are drawn where they are looked up
        Math.floor(corners.reduce((sum, v) => sum + uvs[2 * v + axis] / 3, 0)));
      const point = (v) => `${Math.round(1e4 * (uvs[2 * v] - left))} ${Math.round(1e4 * (uvs[2 * v + 1] - top))}`;
      corners.forEach((a, i) => {
        const b = corners[(i + 1) % 3], key = Math.min(a, b) * n + Math.max(a, b), known = edges.get(key);
        if (known) known.faces += 1;
        else edges.set(key, { faces: 1, line: `M${point(a)}L${point(b)}` });
      });
    }
    const joined = (isBorder) => [...edges.values()].filter((e) => (e.faces === 1) === isBorder).map((e) => e.line).join("");
    return [joined(false), joined(true)];
  }

  async function picture(part, { naturalWidth: width, naturalHeight: height }) {
    const [uvs, indices] = await Promise.all([part.uvs, part.indices].map(webgl.unpacked));
    const kind = part.vertices <= 65535 ? Uint16Array : Uint32Array;
    const [inner, border] = paths(new Float32Array(uvs), new kind(indices));
    const line = (path, wide, color) =>
      `<path d="${path}" stroke="${color}" stroke-width="${wide}" vector-effect="non-scaling-stroke"/>`;
    const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 10000 10000"` +
      ` preserveAspectRatio="none" fill="none">${line(inner, 0.5, "#0de68c")}${line(border, 2.5, "#000a")}` +
      `${line(border, 1.25, "#fff")}</svg>`;
    return `data:image/svg+xml,${encodeURIComponent(svg)}`;
  }

  async function show() {
    const model = JSON.parse(document.getElementById("viewer-data").textContent).models.at(-1);
    for (const layout of document.querySelectorAll("img.layout[data-part]")) {
      if (toggle.checked) {
        const k = Number(layout.dataset.part), texture = layout.closest("figure").querySelector("img");
        await texture.decode();
        if (!made.has(k)) made.set(k, await picture(model.parts[k], texture));
        if (!layout.src) layout.src = made.get(k);
      }
      layout.hidden = !toggle.checked;
    }
  }
  toggle.addEventListener("change", show);
})();
