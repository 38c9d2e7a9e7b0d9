"""Template of the index page: a table, on phones a list of cards; self-contained."""

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<title>matcap batch</title>
<style>
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #fafafa; --line: #d8d8d8;
  --soft: #666; --good: #1d7a3c; --doubt: #9a6200; --bad: #b3261e; --card: #fff; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e8e8; --paper: #161616; --line: #3a3a3a;
  --soft: #a0a0a0; --good: #6fcf8f; --doubt: #f0b429; --bad: #ff8a80; --card: #1f1f1f; } }
* { box-sizing: border-box; }
body { margin: 0; padding: 1rem; background: var(--paper); color: var(--ink);
  font: 15px/1.4 system-ui, sans-serif; }
h1 { font-size: 1.3rem; margin: 0 0 .2rem; }
p { margin: 0 0 1rem; color: var(--soft); }
.tools { display: flex; flex-wrap: wrap; gap: .5rem 1rem; margin-bottom: 1rem; }
.tools label { display: flex; gap: .4rem; align-items: center; }
select, input { font: inherit; padding: .3rem; color: inherit; background: var(--card);
  border: 1px solid var(--line); border-radius: 4px; min-width: 0; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .5rem; border-top: 1px solid var(--line); }
thead th { border-top: 0; white-space: nowrap; position: sticky; top: 0;
  background: var(--paper); z-index: 1; }
thead button { font: inherit; font-weight: 600; color: inherit; background: none; border: 0;
  padding: .2rem; cursor: pointer; border-radius: 4px; }
thead button:focus-visible, a:focus-visible { outline: 2px solid var(--doubt); }
th[aria-sort=ascending] button::after { content: " \\2191"; }
th[aria-sort=descending] button::after { content: " \\2193"; }
tbody th { overflow-wrap: anywhere; min-width: 9.5rem; max-width: 14rem; }
small { display: block; color: var(--soft); font-weight: 400; }
a { color: inherit; }
.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
.state { white-space: nowrap; font-weight: 600; }
.done .state { color: var(--good); }
.doubtful .state { color: var(--doubt); }
.failed .state, .not-begun .state { color: var(--bad); }
.verdict { font-weight: 600; }
.verdict.good { color: var(--good); }
.verdict.doubtful { color: var(--doubt); }
.verdict.failed { color: var(--bad); }
details { font-size: 12px; color: var(--soft); }
summary { cursor: pointer; }
code { user-select: all; overflow-wrap: anywhere; }
.failed:has(.verdict) th { border-left: 4px solid var(--bad); }
.pictures div { display: grid; grid-template-columns: repeat(4, minmax(64px, 108px)); gap: 4px; }
figure { margin: 0; }
figure img { display: block; width: 100%; aspect-ratio: 4 / 3; object-fit: cover;
  border-radius: 3px; transition: transform .1s; }
figure img:hover { transform: scale(2.2); position: relative; z-index: 2; }
figcaption { font-size: 11px; line-height: 1.2; color: var(--soft); }
ul { margin: 0; padding-left: 1.1rem; max-width: 26rem; }
td:last-child { font-size: 13px; }
.tools .phone { display: none; }
@media (max-width: 760px) {
  body { padding: .75rem; }
  .tools .phone { display: flex; }
  thead { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
  table, tbody, tr, td, tbody th { display: block; width: auto; max-width: none; }
  tr { background: var(--card); border: 1px solid var(--line); border-radius: 8px;
    margin-bottom: .75rem; padding: .5rem; }
  tr[hidden] { display: none; }
  th, td { border: 0; padding: .15rem .25rem; }
  td:not(.pictures)::before { content: attr(data-label) ": "; color: var(--soft); }
  td[data-key="0"]:last-child { display: none; }
  .pictures div { grid-template-columns: repeat(4, 1fr); }
  figure img:hover { transform: none; }
  figcaption { font-size: 10px; overflow-wrap: anywhere; }
}
</style>
</head>
<body>
<h1>matcap batch</h1>
<p>@SUMMARY@ · commands under "view" are for a terminal in this page's folder</p>
<div class="tools">
<label>Show <select id="show"><option value="">all</option><option>done</option>
<option>doubtful</option><option>failed</option><option>not begun</option></select></label>
<label>Find <input id="find" type="search" size="14"></label>
<label class="phone">Sort by <select id="sort"></select></label>
</div>
<table>
<thead><tr></tr></thead>
<tbody>
@ROWS@
</tbody>
</table>
<script>
"use strict";
const columns = ["Material", "State", "Pictures", "Verdict", "Tilt", "Clipped", "Time", "Remarks"];
const body = document.querySelector("tbody");
const heads = document.querySelector("thead tr");
const sort = document.getElementById("sort");
let sorted = {column: 0, up: true};

function key(row, column) {
  const text = row.children[column].dataset.key ?? "";
  const number = Number(text);
  return text === "" ? null : Number.isNaN(number) || column < 2 ? text : number;
}

function order(column, up) {
  sorted = {column, up};
  const rows = [...body.rows];
  rows.sort((a, b) => {
    const x = key(a, column), y = key(b, column);
    if (x === null || y === null) return (x === null) - (y === null);  // empty ones last
    return (x < y ? -1 : x > y ? 1 : 0) * (up ? 1 : -1);
  });
  body.append(...rows);
  [...heads.children].forEach((head, i) => {
    if (i === column) head.setAttribute("aria-sort", up ? "ascending" : "descending");
    else head.removeAttribute("aria-sort");
  });
  sort.value = column + (up ? "+" : "-");
}

function filter() {
  const state = document.getElementById("show").value;
  const text = document.getElementById("find").value.toLowerCase();
  for (const row of body.rows)
    row.hidden = (state && row.children[1].dataset.key !== state) ||
      (text && !row.textContent.toLowerCase().includes(text));
}

columns.forEach((name, i) => {
  const head = document.createElement("th");
  head.scope = "col";
  heads.append(head);
  if (name === "Pictures") { head.textContent = name; return; }
  const button = document.createElement("button");
  button.textContent = name;
  button.addEventListener("click", () => order(i, sorted.column === i ? !sorted.up : true));
  head.append(button);
  for (const [way, word] of [["+", "up"], ["-", "down"]])
    sort.add(new Option(name + ", " + word, i + way));
});
sort.addEventListener("change", () =>
  order(Number(sort.value.slice(0, -1)), sort.value.endsWith("+")));
document.getElementById("show").addEventListener("change", filter);
document.getElementById("find").addEventListener("input", filter);
order(0, true);
</script>
</body>
</html>
"""
