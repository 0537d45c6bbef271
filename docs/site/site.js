// On a narrow screen a wide table becomes a list (site.css): each cell then says its column's heading.
for (const table of document.querySelectorAll("table.docutils")) {
  const headings = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent.trim());
  if (headings.length < 4) continue;
  table.classList.add("wide");
  for (const row of table.querySelectorAll("tbody tr")) {
    [...row.cells].forEach((cell, column) => cell.setAttribute("data-heading", headings[column] ?? ""));
  }
}
// A line does not break within a short option or command (site.css).
for (const code of document.querySelectorAll("article :is(p, li) > code.literal")) {
  if (code.textContent.length <= 30 && !code.closest("td")) code.classList.add("short");
}
