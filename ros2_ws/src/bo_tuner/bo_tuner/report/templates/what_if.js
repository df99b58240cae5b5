"use strict";
(() => {
  // Sliders over the predictions of the models. A page by itself has them along each slider, the
  // others being where they were; a server predicts for all of them together.
  const { forecasts } = document.getElementById("main").dataset;
  const TOGETHER = "All sliders count together.";
  const ALONE = "One slider at a time: the others are reset.";

  function adopt(element) {
    const { sliders, along, command } = JSON.parse(element.querySelector("script").textContent);
    const inputs = [...element.querySelectorAll("input[type=range]")];
    const cells = [...element.querySelectorAll("tbody tr")].map((row) => row.cells[1]);
    const remark = element.querySelector(".damage");
    const back = element.querySelector("button");
    const code = element.querySelector("code");
    let latest = 0;
    element.hidden = false;
    element.querySelector(".together").textContent = forecasts ? TOGETHER : ALONE;

    function place(k, at) {
      inputs[k].value = at;
      inputs[k].parentElement.querySelector("output").textContent = sliders[k].words[at];
      inputs[k].setAttribute("aria-valuetext", sliders[k].words[at]);
    }

    function tell() {
      if (!code) return;
      const set = sliders.map(({ name, values }, k) => `--set ${name}=${values[Number(inputs[k].value)]}`);
      code.textContent = [command, ...set].join(" ");
      element.querySelector(".copy").dataset.copy = code.textContent;
    }
    tell();

    function show({ cells: texts, remark: words }) {
      cells.forEach((cell, k) => { cell.textContent = texts[k]; });
      remark.textContent = words;
      remark.hidden = !words;
    }

    async function predict() {
      const request = (latest += 1);
      const values = sliders.map(({ name, values: all }, k) => [name, all[Number(inputs[k].value)]]);
      let forecast;
      try {
        const answer = await fetch(`${forecasts}?${new URLSearchParams(values)}`, { cache: "no-store" });
        if (!answer.ok) throw new Error(await answer.text());
        forecast = await answer.json();
      } catch {
        forecast = { cells: cells.map(() => "\u2013"), remark: "The server cannot predict this" };
      }
      // A slider that is drawn asks faster than it is answered.
      if (request === latest) show(forecast);
    }

    inputs.forEach((input, k) => input.addEventListener("input", () => {
      const at = Number(input.value);
      back.disabled = false;
      if (!forecasts) sliders.forEach((slider, other) => place(other, slider.place));
      place(k, at);
      tell();
      if (forecasts) predict();
      else show(along[k][at]);
    }));
    back.addEventListener("click", () => {
      latest += 1;
      sliders.forEach((slider, k) => place(k, slider.place));
      tell();
      show(along[0][sliders[0].place]);
      back.disabled = true;
    });
  }

  const all = (root) => root.querySelectorAll(".what-if").forEach(adopt);
  all(document);
  document.addEventListener("replaced", (event) => all(event.target));
})();
