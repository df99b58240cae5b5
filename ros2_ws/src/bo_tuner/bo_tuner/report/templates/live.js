"use strict";
(() => {
  // The page of a run in progress: asks for what is new, and replaces the sections that changed.
  const RETRY = 2000; // after a request that failed [ms]
  const MOST_FAILURES = 3; // in a row, after which the reader is told
  const LATER = 10000; // after more of them [ms]: a tunnel may be mended, and a laptop wake up
  const main = document.getElementById("main");
  const now = document.getElementById("now");
  const title = now.querySelector("h2");
  const links = document.querySelector("nav ul");
  const waiting = new Map(); // sections that the reader is busy with, by name

  const control = now.querySelector(".control");
  const question = now.querySelector(".question");

  const of = (name) => document.getElementById(name);

  function showNow({ now: state, problem, stamp }) {
    const counted = state.total ? ` ${state.done} of ${state.total}` : "";
    const left = state.time_left ? `, ${state.time_left} left` : "";
    const phase = state.phase || "starting";
    let text = `${phase[0].toUpperCase()}${phase.slice(1)}${counted && `:${counted}`}${left}${state.paused ? ", PAUSED" : ""}`;
    if (state.verdict) text = state.verdict;
    if (state.ended) text = state.verdict ? `Ended. ${state.verdict}` : "The run has ended; see the terminal of tune";
    if (title.textContent !== text) title.textContent = text;
    if (state.ended) of("kind").textContent = "Tuning run, which has ended";
    now.querySelector(".stamp").textContent = stamp ? `${stamp}: all that is below.` : "";
    document.title = `${text} - ${document.querySelector("h1").textContent}`;
    const bar = now.querySelector("progress");
    bar.max = state.total || 1;
    bar.value = state.ended ? bar.max : state.done || 0;
    const trouble = now.querySelector(".damage");
    trouble.textContent = problem;
    trouble.hidden = !problem;
    if (control) showControl(state);
    showQuestion(state.question || { lines: [] });
    now.querySelector("dl").replaceChildren(
      ...Object.entries(state.texts || {}).map(([name, text]) => {
        const row = document.createElement("div");
        const [term, words] = [document.createElement("dt"), document.createElement("dd")];
        term.textContent = name;
        words.textContent = text;
        row.append(term, words);
        return row;
      })
    );
  }

  // An answer is one to the question that stands here, by its number.
  function showQuestion({ number, lines }) {
    question.hidden = !lines.length;
    question.dataset.number = number;
    const text = lines.join("\n");
    const shown = question.querySelector("pre");
    if (shown.textContent !== text) shown.textContent = text;
  }

  const button = (request) => control.querySelector(`[data-request=${request}]`);

  // The button with the focus stays where it is, although it becomes the other one.
  function showControl(state) {
    control.hidden = Boolean(state.ended);
    const focused = control.querySelector("[data-request]:focus");
    button("pause").hidden = state.pausing;
    button("continue").hidden = !state.pausing;
    if (focused && focused.hidden) button(state.pausing ? "continue" : "pause").focus();
  }

  async function ask(address) {
    const trouble = control.querySelector(".damage");
    try {
      const answer = await fetch(`requests/${address}`, {
        method: "POST",
        headers: { "X-Control-Token": control.dataset.token },
      });
      trouble.textContent = answer.ok ? "" : await answer.text();
    } catch {
      trouble.textContent = "The run cannot be reached";
    }
    trouble.hidden = !trouble.textContent;
  }
  if (control) {
    for (const item of control.querySelectorAll("[data-request]")) {
      item.addEventListener("click", () => ask(item.dataset.request));
    }
    for (const item of question.querySelectorAll("[data-request]")) {
      const answer = item.dataset.request;
      item.addEventListener("click", () => ask(`${answer}?question=${question.dataset.number}`));
    }
  }

  // Keeps what is unfolded and typed; a section with the focus in it waits.
  function replace(name, html) {
    const old = of(name);
    if (old && old.contains(document.activeElement)) {
      waiting.set(name, html);
      return;
    }
    const holder = document.createElement("template");
    holder.innerHTML = html;
    const section = holder.content.querySelector("section");
    if (old) {
      const open = [...old.querySelectorAll("details")].map((details) => details.open);
      section.querySelectorAll("details").forEach((details, k) => { details.open = open[k] || false; });
      leave(old);
      old.replaceWith(section);
    } else {
      main.append(section);
    }
    section.dispatchEvent(new CustomEvent("replaced", { bubbles: true }));
    if (old) keepTables(old, section);
  }

  // What watches a section would keep it in memory.
  function leave(section) {
    section.dispatchEvent(new CustomEvent("removed", { bubbles: true }));
  }

  // The words that a table is filtered by, and the column that it is sorted by.
  function keepTables(old, section) {
    const filters = [...section.querySelectorAll(".filter input")];
    [...old.querySelectorAll(".filter input")].forEach((input, k) => {
      if (!input.value || !filters[k]) return;
      filters[k].value = input.value;
      filters[k].dispatchEvent(new Event("input"));
    });
    const tables = [...section.querySelectorAll("table.sortable")];
    [...old.querySelectorAll("table.sortable")].forEach((table, k) => {
      const column = [...table.tHead.rows[0].cells].findIndex((head) => head.hasAttribute("aria-sort"));
      const head = column >= 0 && tables[k] && tables[k].tHead.rows[0].cells[column];
      if (!head) return;
      const clicks = table.tHead.rows[0].cells[column].getAttribute("aria-sort") === "descending" ? 2 : 1;
      for (let n = 0; n < clicks; n += 1) head.querySelector("button").click();
    });
  }

  function putInOrder(titles) {
    const found = Object.keys(titles).map(of).filter(Boolean);
    for (const section of [...main.querySelectorAll(":scope > section")]) {
      if (section === now || found.includes(section)) continue;
      leave(section);
      section.remove();
    }
    // Without moving what is in place: a moved figure would be drawn again.
    let before = now;
    for (const section of found) {
      if (before.nextElementSibling !== section) before.after(section);
      before = section;
    }
    const names = ["now", ...found.map((section) => section.id)];
    if (names.join() !== [...links.querySelectorAll("a")].map((a) => a.hash.slice(1)).join()) {
      links.replaceChildren(
        ...names.map((name) => {
          const [item, link] = [document.createElement("li"), document.createElement("a")];
          link.href = `#${name}`;
          link.textContent = titles[name] || "Now";
          item.append(link);
          return item;
        })
      );
    }
  }

  main.addEventListener("focusout", () => setTimeout(() => {
    for (const [name, html] of [...waiting]) {
      waiting.delete(name);
      replace(name, html);
    }
  }, 0));

  async function follow() {
    let page = "";
    let version = -1;
    let failures = 0;
    let ended = false;
    for (;;) {
      try {
        const answer = await fetch(`state?after=${version}`, { cache: "no-store" });
        if (!answer.ok) throw new Error(answer.statusText);
        const news = await answer.json();
        // Another run has taken the port, and its sections are no sections of this one.
        if (page && news.page !== page) return location.reload();
        page = news.page;
        showNow(news);
        for (const [name, html] of Object.entries(news.sections)) {
          waiting.delete(name);
          replace(name, html);
        }
        putInOrder(news.order);
        // What went wrong with the sections would be asked for again.
        version = news.version;
        failures = 0;
        document.documentElement.dataset.version = version;
        if (news.complete) return;
        ended = news.now.ended;
      } catch (error) {
        if (ended) return;
        failures += 1;
        const gone = failures >= MOST_FAILURES;
        if (gone) title.textContent = "The run has ended, or cannot be reached; this is its last state";
        await new Promise((done) => setTimeout(done, gone ? LATER : RETRY));
      }
    }
  }
  follow();
})();
