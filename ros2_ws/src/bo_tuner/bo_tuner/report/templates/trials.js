"use strict";
(() => {
  // Tables of trials and points in figures lead to a trial: to its page where there is one, else to
  // its row in the table of all trials.
  const { trials } = document.getElementById("main").dataset;
  const ofTrials = (table) => table.tHead.rows[0].cells[0].textContent.trim() === "trial";

  function link(root) {
    if (trials === undefined) return;
    for (const table of [...root.querySelectorAll("table")].filter(ofTrials)) {
      for (const { cells: [cell] } of table.tBodies[0].rows) {
        const number = cell.textContent.trim();
        if (!/^\d+$/.test(number)) continue;
        const to = document.createElement("a");
        to.href = trials + number;
        to.textContent = number;
        cell.replaceChildren(to);
      }
    }
  }
  link(document);
  document.addEventListener("replaced", (event) => link(event.target));

  document.addEventListener("trial", ({ detail: number, target }) => {
    // In the front a point is a choice.
    const choice = target.closest("#figure-front") && document.querySelector(`details.choice[data-trial="${number}"]`);
    if (choice) {
      choice.open = true;
      choice.scrollIntoView({ block: "nearest" });
      return;
    }
    if (trials !== undefined) {
      location.assign(trials + number);
      return;
    }
    const rows = [...document.querySelectorAll("#all-trials tbody tr")];
    const row = rows.find(({ cells: [cell] }) => cell.textContent.trim() === String(number));
    if (!row) return;
    for (let within = row.closest("details"); within; within = within.parentElement.closest("details")) {
      within.open = true;
    }
    rows.forEach((other) => other.classList.toggle("sought", other === row));
    row.scrollIntoView({ block: "center" });
  });
})();
