"use strict";
(() => {
  // The list of runs: asks for it again, and changes the rows that have changed, in place.
  const PERIOD = 3000; // between two requests [ms]
  const section = document.getElementById("runs");
  const table = section.querySelector("table");
  const trouble = section.querySelector(".damage");
  const nameOf = (row) => row.querySelector("input").value;

  function change(cell, fresh) {
    if (cell.innerHTML !== fresh.innerHTML) cell.replaceChildren(...fresh.childNodes);
  }

  // What is ticked stays, and so does the focus: a row that is known is neither replaced nor moved
  // without need.
  function merge(list) {
    const body = table.tBodies[0];
    const known = new Map([...body.rows].map((row) => [nameOf(row), row]));
    let before = null;
    for (const fresh of [...list.querySelector("tbody").rows]) {
      const row = known.get(nameOf(fresh)) || fresh;
      known.delete(nameOf(fresh));
      if (row !== fresh) {
        row.className = fresh.className;
        [...row.cells].slice(1).forEach((cell, k) => change(cell, fresh.cells[k + 1]));
      }
      const place = before ? before.nextElementSibling : body.firstElementChild;
      if (row !== place) body.insertBefore(row, place);
      before = row;
    }
    known.forEach((row) => row.remove());
    const region = list.querySelector(".scroll");
    table.closest(".scroll").setAttribute("aria-label", region.getAttribute("aria-label"));
    change(table.caption, list.querySelector("caption"));
    change(section.querySelector(".listed"), list.querySelector(".listed"));
    section.toggleAttribute("data-unread", list.querySelector("#runs").hasAttribute("data-unread"));
    table.dispatchEvent(new CustomEvent("changed"));
  }

  async function follow() {
    let last = "";
    for (;;) {
      // A list that is not complete comes after the runs that were read meanwhile.
      const wait = section.hasAttribute("data-unread") && trouble.hidden ? 0 : PERIOD;
      await new Promise((done) => setTimeout(done, wait));
      if (document.hidden) continue;
      try {
        const answer = await fetch(section.dataset.news, { cache: "no-store" });
        if (!answer.ok) throw new Error(await answer.text());
        const html = await answer.text();
        const holder = document.createElement("template");
        holder.innerHTML = html;
        if (html !== last) merge(holder.content);
        last = html;
        trouble.hidden = true;
      } catch {
        trouble.textContent = "The list cannot be brought up to date: the server cannot be reached";
        trouble.hidden = false;
      }
    }
  }
  follow();
})();
