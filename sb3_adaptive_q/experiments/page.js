"use strict";
// Numbers come before texts; of "0.45 [0.40, 0.50]" the first number counts. "3.11.7" and "18e4f0b" are texts
function key(cell) {
  const match = cell.textContent.replace("−", "-").match(/^\s*[+-]?\d+(\.\d+)?(e[+-]?\d+)?(?![\w.])/i);
  return match ? Number(match[0]) : cell.textContent.trim();
}

function compare(a, b) {
  if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
  return typeof a === "number" ? a - b : a.localeCompare(b);
}

function sort(table, column, heading) {
  const ascending = heading.getAttribute("aria-sort") === "descending";
  const rows = Array.from(table.tBodies[0].rows);
  rows.sort((a, b) => (ascending ? 1 : -1) * compare(key(a.cells[column]), key(b.cells[column])));
  table.tBodies[0].append(...rows);
  for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", ascending ? "ascending" : "descending");
}

for (const table of document.querySelectorAll("table")) {
  for (const cell of table.querySelectorAll("td")) if (cell.textContent.length > 40) cell.classList.add("text");
  Array.from(table.tHead.rows[0].cells).forEach((heading, column) => {
    if (!heading.textContent) return;
    const button = document.createElement("button");
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => sort(table, column, heading));
  });
}
