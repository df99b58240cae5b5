"use strict";
(() => {
  // Buttons that copy a text, and links into what is closed.
  addEventListener("hashchange", () => {
    const details = document.querySelector(location.hash || "#none")?.querySelector("details.chapter");
    if (details) details.open = true;
  });

  for (const button of document.querySelectorAll("button.copy")) offer(button);
  document.addEventListener("replaced", (event) => event.target.querySelectorAll("button.copy").forEach(offer));
  function offer(button) {
    const words = button.textContent;
    button.hidden = false;
    button.addEventListener("click", async () => {
      button.textContent = (await copied(button.dataset.copy)) ? "Copied" : "Copy it from best.yaml";
      setTimeout(() => { button.textContent = words; }, 2000);
    });
  }
  // A page from a file has no clipboard in some browsers, but may copy what is selected.
  async function copied(text) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand("copy");
      area.remove();
      return done;
    }
  }
})();
