"use strict";
// The report's pictures: a divider between any two of a view, whose errors the grid shows, and one enlarged.
(() => {
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const figures = all(".views figure");

  // Whose errors the grid shows.
  const errorsOf = document.getElementById("errors-of");
  errorsOf?.addEventListener("change", () => {
    for (const cell of all(".views [data-of]")) cell.hidden = cell.dataset.of !== errorsOf.value;
  });

  // The divider.
  const compare = document.getElementById("compare");
  if (compare) {
    const stage = document.getElementById("stage");
    const sides = ["left", "right"].map((name) => ({
      name,
      picker: compare.querySelector(`select[data-side=${name}]`),
      image: stage.querySelector(`img.${name}`),
      tag: stage.querySelector(`.tag.${name}`),
    }));
    const thumbs = all(".thumbs button", compare);
    let view = 0;

    const show = () => {
      for (const { picker, image, tag } of sides) {
        const figure = figures.find((f) => f.dataset.view == view && f.dataset.index === picker.value);
        image.src = figure.querySelector("img").src;
        image.alt = figure.querySelector("img").alt;
        tag.textContent = picker.selectedOptions[0].text;
        tag.title = tag.dataset.figure = figure.querySelector("figcaption").textContent;
      }
      thumbs.forEach((thumb, k) => thumb.setAttribute("aria-current", k === view));
    };
    const move = (percent) => {
      percent = Math.min(100, Math.max(0, percent));
      stage.style.setProperty("--at", `${percent}%`);
      stage.setAttribute("aria-valuenow", Math.round(percent));
    };
    const turnTo = (k) => {
      view = (k + thumbs.length) % thumbs.length;
      show();
    };

    for (const { name, picker } of sides) {
      picker.value = compare.dataset[name];
      picker.addEventListener("change", show);
    }
    thumbs.forEach((thumb, k) => {
      const picture = new Image();
      picture.src = figures.find((f) => f.dataset.view == k && f.dataset.index === "0").querySelector("img").src;
      picture.alt = "";
      thumb.append(picture);
      thumb.addEventListener("click", () => turnTo(k));
    });
    const follow = (event) => {
      const box = stage.getBoundingClientRect();
      move((100 * (event.clientX - box.left)) / box.width);
    };
    stage.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      stage.setPointerCapture(event.pointerId);
      follow(event);
    });
    stage.addEventListener("pointermove", (event) => stage.hasPointerCapture(event.pointerId) && follow(event));
    stage.addEventListener("keydown", (event) => {
      const at = Number(stage.getAttribute("aria-valuenow"));
      const to = { ArrowLeft: at - 2, ArrowRight: at + 2, PageDown: at - 20, PageUp: at + 20, Home: 0, End: 100 }[event.key];
      if (to !== undefined) move(to);
      else if (event.key === "ArrowDown") turnTo(view + 1);
      else if (event.key === "ArrowUp") turnTo(view - 1);
      else return;
      event.preventDefault();
    });
    move(50);
    show();
    compare.hidden = false;
  }

  // One picture, as large as the window lets it.
  const dialog = document.getElementById("enlarged");
  for (const image of all("img.zoom")) {
    image.tabIndex = 0;
    image.setAttribute("role", "button");
    const open = () => {
      const [picture, layout, text] = dialog.querySelectorAll("img, p"), own = image.closest("figure")?.querySelector("img.layout");
      picture.src = image.src;
      picture.alt = image.alt;
      picture.classList.toggle("pixelated", image.naturalWidth < 400);
      layout.hidden = !own || own.hidden;
      if (!layout.hidden) layout.src = own.src;
      const caption = image.closest("figure")?.querySelector("figcaption")?.textContent;
      text.textContent = !caption || caption.startsWith(image.alt) ? caption || image.alt : `${image.alt}: ${caption}`;
      dialog.showModal();
    };
    image.addEventListener("click", open);
    image.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      open();
    });
  }
  dialog.addEventListener("click", () => dialog.close());
})();
