"use strict";
// The table of a batch: sorted by a column, filtered by a text. Of many rows only the first are in the page until the
// others are asked for: a browser takes seconds to lay out ten thousand.
const body = document.querySelector(".batch tbody");
const more = document.getElementById("more");
const search = document.getElementById("search");
const rows = [...body.rows];
for (const row of rows) {
  row.text = row.textContent.toLowerCase();
  row.hidden = false;
}
let most = Number(body.dataset.most);

function show() {
  const wanted = search.value.toLowerCase();
  const found = rows.filter((row) => row.text.includes(wanted));
  body.replaceChildren(...found.slice(0, most));
  more.hidden = found.length <= most;
  more.textContent = `Show all ${found.length}`;
}

for (const head of document.querySelectorAll("th[data-key]")) {
  head.querySelector("button").addEventListener("click", () => {
    const rising = head.getAttribute("aria-sort") !== "ascending";
    for (const other of document.querySelectorAll("th")) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", rising ? "ascending" : "descending");
    const value = (row) => row.cells[head.cellIndex].dataset.value;
    const number = rows.every((row) => value(row) === "" || !isNaN(value(row)));
    rows.sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      if ((x === "") !== (y === "")) return x === "" ? 1 : -1; // what is unknown comes last, either way
      const order = number ? x - y : x.localeCompare(y);
      return rising ? order : -order;
    });
    show();
  });
}

search.addEventListener("input", show);
more.addEventListener("click", () => {
  most = rows.length;
  show();
});
show();
