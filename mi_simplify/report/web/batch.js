"use strict";
// The table of a batch: sorted by a column, filtered by a text.
const body = document.querySelector(".batch tbody");
const rows = [...body.rows];
for (const row of rows) row.text = row.textContent.toLowerCase();

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
    body.replaceChildren(...rows);
  });
}

document.getElementById("search").addEventListener("input", (event) => {
  const wanted = event.target.value.toLowerCase();
  for (const row of rows) row.hidden = !row.text.includes(wanted);
});
