"use strict";
(() => {
  // Commands that this page may start, one at a time; what it prints stands below the result.
  const panel = document.getElementById("started");
  if (!panel) return;
  const { token, start, news, stop } = panel.dataset;
  const of = (part) => panel.querySelector(`.${part}`);
  const RETRY = 2000; // after a request that failed [ms]
  let asked = false; // whether this page has just started it

  async function post(address, body) {
    try {
      const answer = await fetch(address, { method: "POST", headers: { "X-Control-Token": token }, body });
      return answer.ok ? "" : await answer.text();
    } catch {
      return "The server cannot be reached";
    }
  }
  function complain(problem) {
    of("damage").textContent = problem;
    of("damage").hidden = !problem;
    if (!problem) return;
    panel.hidden = false;
    panel.scrollIntoView({ block: "center" });
  }

  for (const button of document.querySelectorAll("button.start")) {
    button.hidden = false;
    button.addEventListener("click", async () => {
      asked = true;
      button.closest("details.menu")?.removeAttribute("open");
      complain(await post(start, button.parentElement.querySelector("code").textContent));
    });
  }
  of("end").addEventListener("click", async () => complain(await post(stop)));

  function show({ command, lines, running, exit_code: code }) {
    if (!command) return;
    panel.hidden = false;
    of("command").textContent = command;
    of("state").textContent = running ? "Running" : `Ended with exit code ${code}`;
    of("end").hidden = !running;
    of("result").hidden = running;
    const output = of("output");
    const atEnd = output.scrollTop + output.clientHeight >= output.scrollHeight - 5;
    output.textContent = lines.join("\n");
    if (atEnd) output.scrollTop = output.scrollHeight;
    if (asked) panel.scrollIntoView({ block: "center" });
    asked = false;
  }

  async function follow() {
    let version = -1;
    for (;;) {
      try {
        const answer = await fetch(`${news}?after=${version}`, { cache: "no-store" });
        if (!answer.ok) throw new Error(await answer.text());
        const found = await answer.json();
        ({ version } = found);
        show(found);
      } catch {
        version = -1;
        await new Promise((resolve) => { setTimeout(resolve, RETRY); });
      }
    }
  }
  follow();
})();
