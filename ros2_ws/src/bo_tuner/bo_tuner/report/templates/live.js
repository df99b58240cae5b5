"use strict";
(() => {
  // The page of a run in progress: asks for what is new, and replaces the parts that changed.
  const RETRY = 2000; // after a request that failed [ms]
  const MOST_FAILURES = 3; // in a row, after which the reader is told
  const LATER = 10000; // after more of them [ms]: a tunnel may be mended, and a laptop wake up
  const of = (name) => document.getElementById(name);
  const now = of("now");
  const line = of("state");
  const name = document.querySelector("h1").textContent;
  const question = of("question");
  const control = document.querySelector(".control");
  let asked = 0; // when the question came up [ms]
  let said = "";

  const set = (element, text) => { if (element.textContent !== text) element.textContent = text; };
  const complain = (text) => { of("problem").hidden = !text; set(of("problem"), text); };

  function inWords(state) {
    if (state.ended) return state.verdict ? `Ended. ${state.verdict}` : "The run has ended; see the terminal of tune";
    if (state.verdict) return state.verdict;
    const counted = state.total ? `: ${state.done} of ${state.total}` : "";
    const left = state.time_left ? `, ${state.time_left} left` : "";
    const phase = state.phase || "starting";
    return `${phase[0].toUpperCase()}${phase.slice(1)}${counted}${left}${state.paused && question.hidden ? ", PAUSED" : ""}`;
  }

  // Who listens is told of the question, and not of each second.
  function showState() {
    const seconds = Math.round((Date.now() - asked) / 1000);
    of("waiting").hidden = question.hidden;
    set(of("waiting"), `Waiting for you · ${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`);
    document.title = `${question.hidden ? said : "Waiting for you"} - ${name}`;
  }
  setInterval(() => { if (!question.hidden) showState(); }, 1000);

  function showNow({ now: state, problem }) {
    showQuestion(state.question || { html: "" });
    said = inWords(state);
    set(line, said);
    const bar = document.querySelector("progress");
    bar.max = state.total || 1;
    bar.value = state.ended ? bar.max : state.done || 0;
    complain(problem);
    set(of("best"), state.best || "none yet");
    if (control) showControl(state);
    showState();
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
  function showQuestion({ number, html }) {
    question.hidden = !html;
    now.hidden = Boolean(html);
    if (!html || question.dataset.number === String(number)) return;
    asked = Date.now();
    question.dataset.number = number;
    of("asked").innerHTML = html;
  }

  const button = (request) => control.querySelector(`[data-request=${request}]`);

  // The button with the focus stays where it is, although it becomes the other one.
  function showControl(state) {
    control.hidden = Boolean(state.ended);
    const focused = control.querySelector("[data-request]:focus");
    button("pause").hidden = state.pausing || !question.hidden;
    button("continue").hidden = !state.pausing;
    if (focused && focused.hidden) button(state.pausing ? "continue" : "pause").focus();
  }

  async function ask(address) {
    try {
      const answer = await fetch(`requests/${address}`, {
        method: "POST",
        headers: { "X-Control-Token": control.dataset.token },
      });
      complain(answer.ok ? "" : await answer.text());
    } catch {
      complain("The run cannot be reached");
    }
  }
  if (control) {
    const reply = (answer) => ask(`${answer}?question=${question.dataset.number}`);
    for (const item of control.querySelectorAll("[data-request]")) {
      item.addEventListener("click", () => ask(item.dataset.request));
    }
    for (const item of question.querySelectorAll("[data-request]")) {
      item.addEventListener("click", () => reply(item.dataset.request));
    }
    addEventListener("keydown", (event) => {
      const answer = { y: "accept", n: "refuse" }[event.key.toLowerCase()];
      // A key that is held, or part of a shortcut, is no answer.
      if (!answer || question.hidden || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
      reply(answer);
    });
  }

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
        // Another run has taken the port, and its parts are no parts of this one.
        if (page && news.page !== page) return location.reload();
        page = news.page;
        showNow(news);
        for (const [name, html] of Object.entries(news.sections)) {
          of(name).innerHTML = html;
          of(name).hidden = false;
          of(name).dispatchEvent(new CustomEvent("replaced", { bubbles: true }));
        }
        // What went wrong with the parts would be asked for again.
        version = news.version;
        failures = 0;
        document.documentElement.dataset.version = version;
        if (news.complete) return;
        ended = news.now.ended;
      } catch (error) {
        if (ended) return;
        failures += 1;
        const gone = failures >= MOST_FAILURES;
        if (gone) set(line, "The run has ended, or cannot be reached; this is its last state");
        await new Promise((done) => setTimeout(done, gone ? LATER : RETRY));
      }
    }
  }
  follow();
})();
