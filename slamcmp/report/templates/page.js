"use strict";
for (const button of document.querySelectorAll("button[data-only]")) {
  const table = document.getElementById(button.dataset.only);
  const groups = [...table.querySelectorAll("tr.groups th")];
  const spans = groups.map(head => head.colSpan);
  const heads = [...table.tHead.rows[1].cells];
  const show = only => {
    button.setAttribute("aria-pressed", only);
    table.classList.toggle("differing", only);
    let start = 0;
    groups.forEach((group, index) => {
      const own = heads.slice(start, start + spans[index]);
      const shown = own.filter(head => !only || !head.classList.contains("alike")).length;
      start += spans[index];
      group.hidden = shown === 0;
      group.colSpan = Math.max(1, shown);
    });
  };
  button.addEventListener("click", () => show(button.getAttribute("aria-pressed") !== "true"));
  show(true);
}
addEventListener("beforeprint", () => {
  for (const box of document.querySelectorAll("details")) box.open = true;
});
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach(other => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const body = table.tBodies[0];
      const key = row => row.cells[column].dataset.order;
      const rows = [...body.rows].sort((a, b) => {
        const x = key(a), y = key(b);
        if (x === "" || y === "") return (x === "") - (y === "");
        const difference = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y;
        return down ? -difference : difference;
      });
      body.append(...rows);
    });
  });
}
