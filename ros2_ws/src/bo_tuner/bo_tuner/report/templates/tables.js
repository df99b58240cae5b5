"use strict";
(() => {
  // Tables that can be sorted by a column, and filtered by words.
  function sortable(table) {
    const body = table.tBodies[0];
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const falling = head.getAttribute("aria-sort") === "ascending";
        for (const other of heads) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", falling ? "descending" : "ascending");
        sort();
      });
    });
    function sort() {
      const column = heads.findIndex((head) => head.hasAttribute("aria-sort"));
      if (column < 0) return;
      const falling = heads[column].getAttribute("aria-sort") === "descending";
      body.append(...sorted([...body.rows], column, falling));
    }

    const line = document.createElement("p");
    line.className = "filter";
    line.innerHTML = '<label>Filter <input type="search" placeholder="words in a row"></label><output></output>';
    const [input, count] = [line.querySelector("input"), line.querySelector("output")];
    input.addEventListener("input", filter);
    function filter() {
      const rows = [...body.rows];
      const words = input.value.toLowerCase().split(/\s+/);
      for (const row of rows) {
        const text = [...row.cells].map((cell) => cell.textContent.trim()).join(" ").toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
      }
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
    }
    // The list of runs changes while it is read.
    table.addEventListener("changed", () => {
      sort();
      if (input.value) filter();
    });
    table.parentElement.before(line);
  }

  // Numbers by value and texts by letters; cells without a value stay at the end.
  function sorted(rows, column, falling) {
    const text = (row) => row.cells[column].textContent.trim();
    const empty = (row) => ["", "–"].includes(text(row));
    const compare = (a, b) => {
      const [x, y] = [Number(text(a)), Number(text(b))];
      return Number.isNaN(x) || Number.isNaN(y)
        ? text(a).localeCompare(text(b), undefined, { numeric: true })
        : x - y;
    };
    return [...rows].sort(
      (a, b) => empty(a) - empty(b) || (falling ? compare(b, a) : compare(a, b))
    );
  }

  // In words, too: a shadow alone is easily overlooked on a phone.
  const CUE = "Scroll the table sideways for more \u2192";
  const watcher = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      const region = target.closest(".scroll");
      const cue = region.previousElementSibling;
      const wide = region.scrollWidth > region.clientWidth + 1;
      if (cue && cue.classList.contains("cue")) cue.hidden = !wide;
      else if (wide) {
        const line = document.createElement("p");
        line.className = "cue";
        line.textContent = CUE;
        region.before(line);
      }
    }
  });
  function adopt(root) {
    for (const table of root.querySelectorAll("table.sortable")) sortable(table);
    for (const region of root.querySelectorAll(".scroll")) {
      watcher.observe(region);
      watcher.observe(region.firstElementChild);
    }
  }
  adopt(document);
  document.addEventListener("replaced", (event) => adopt(event.target));
})();
