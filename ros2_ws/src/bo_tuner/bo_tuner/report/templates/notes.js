"use strict";
(() => {
  // Notes on a run or a trial, which the server keeps beside its journal.
  for (const form of document.querySelectorAll("form.note")) {
    const said = form.querySelector("output");
    form.addEventListener("input", () => { said.textContent = "Not saved yet"; });
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const { text, tags } = form.elements;
      try {
        const answer = await fetch(form.dataset.address, {
          method: "POST",
          headers: { "X-Control-Token": form.dataset.token },
          body: JSON.stringify({ text: text.value, tags: tags.value }),
        });
        said.textContent = answer.ok ? "Saved" : await answer.text();
      } catch {
        said.textContent = "Not saved: the server cannot be reached";
      }
    });
  }
})();
