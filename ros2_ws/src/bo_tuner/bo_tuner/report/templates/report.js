"use strict";
(() => {
  const shades = JSON.parse(document.getElementById("shades").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const PRINT_WIDTH = 680; // of an A4 page between its margins [px]
  const GAP = 6; // between panels [px]
  const PRINT_SCALE = 0.52; // of the height of panels, as in the style sheet
  const config = {
    displaylogo: false,
    responsive: false,
    displayModeBar: false,
    doubleClick: "reset",
    scrollZoom: false,
  };

  // "@blue/0.2" becomes the palette's blue with that opacity.
  function shade(palette, name, opacity) {
    if (name === "none") return "rgba(0,0,0,0)";
    const color = palette[name === "grid" ? "gray" : name];
    const [r, g, b] = [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16));
    return `rgba(${r},${g},${b},${opacity || (name === "grid" ? 0.25 : 1)})`;
  }

  class Figure {
    constructor(element) {
      this.element = element;
      this.text = element.querySelector("script").textContent;
      this.plots = [...element.querySelectorAll(".plot")];
      this.hidden = new Set();
      this.theme = "";
      for (const button of element.querySelectorAll(".legend button")) {
        button.addEventListener("click", () => this.toggle(button));
      }
    }

    // Draws all panels in a theme, each with a `width` [px] or that of its container.
    draw(theme, width, scale = 1) {
      const palette = shades[theme];
      const { texts, panels } = JSON.parse(
        this.text.replace(/"@([a-z]+)(?:\/([0-9.]+))?"/g, (_, name, opacity) =>
          JSON.stringify(shade(palette, name, opacity))
        )
      );
      panels.forEach((panel, k) => {
        for (const item of [...panel.data, ...panel.layout.shapes]) {
          if (this.hidden.has(item.name)) item.visible = false;
          if (item.hovertext) item.hovertext = item.hovertext.map((place) => texts[place]);
          // The page has a tip of its own: that of Plotly may cover the axes.
          if (item.hoverinfo && item.hoverinfo !== "skip") item.hoverinfo = "none";
        }
        panel.layout.width = width || this.plots[k].clientWidth;
        panel.layout.height *= scale;
        // In place of the picture of a page without scripts.
        if (!this.theme) this.plots[k].replaceChildren();
        Plotly.react(this.plots[k], panel.data, panel.layout, config);
        if (!this.theme) {
          addTip(this.plots[k]);
          leadToTrials(this.plots[k]);
        }
      });
      this.theme = theme;
      performance.mark("figure");
    }

    toggle(button) {
      const name = button.dataset.name;
      const show = this.hidden.has(escaped(name));
      if (show) this.hidden.delete(escaped(name));
      else this.hidden.add(escaped(name));
      button.setAttribute("aria-pressed", String(show));
      this.draw(this.theme || theme());
    }
  }

  const BESIDE = 12; // between a point and its tip [px]

  // A tip that stays within the axes, and on the side of the point where there is more room.
  function addTip(plot) {
    const tip = document.createElement("div");
    tip.className = "tip";
    tip.hidden = true;
    plot.append(tip);
    plot.on("plotly_unhover", () => { tip.hidden = true; });
    plot.on("plotly_hover", ({ points: [point] }) => {
      tip.textContent = told(point);
      tip.hidden = false;
      const { l, t, w, h } = plot._fullLayout._size;
      tip.style.maxWidth = `${w}px`;
      tip.style.maxHeight = `${h}px`;
      const x = l + point.xaxis.d2p(point.x);
      const y = t + point.yaxis.d2p(point.y);
      const left = x > l + w / 2 ? x - BESIDE - tip.offsetWidth : x + BESIDE;
      const within = (place, low, high) => Math.max(low, Math.min(place, high));
      tip.style.left = `${within(left, l, l + w - tip.offsetWidth)}px`;
      tip.style.top = `${within(y - tip.offsetHeight / 2, t, t + h - tip.offsetHeight)}px`;
    });
  }

  // A point that is a trial, or a test run of one, leads to it.
  function leadToTrials(plot) {
    plot.on("plotly_click", ({ points: [point] }) => {
      if (typeof point.customdata !== "number") return;
      plot.dispatchEvent(new CustomEvent("trial", { bubbles: true, detail: point.customdata }));
    });
  }

  function told(point) {
    if (point.hovertext) return unescaped(point.hovertext) + (typeof point.customdata === "number" ? "\n(click to open)" : "");
    const number = (value) => (typeof value === "number" ? Number(value.toPrecision(4)) : value);
    const of = (axis, value) => `${axis.title.text || ""} ${number(value)}`.trim();
    const lines = [of(point.xaxis, point.x), of(point.yaxis, point.y)];
    if (point.z !== undefined) lines.push(String(number(point.z)));
    else if (point.data.name) lines.unshift(point.data.name);
    return unescaped(lines.join("<br>"));
  }

  function unescaped(text) {
    const names = { "&lt;": "<", "&gt;": ">", "&amp;": "&" };
    return text.replace(/<br>/g, "\n").replace(/&(lt|gt|amp);/g, (name) => names[name]);
  }

  // Names in the data are escaped a second time, since Plotly interprets some markup.
  function escaped(text) {
    return text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  }

  const theme = () => (dark.matches ? "dark" : "light");
  let figures = [];
  const closed = (figure) => figure.element.closest("details:not([open])") !== null;
  const undrawn = () => figures.filter((figure) => !figure.theme && !closed(figure));

  // Visible figures are drawn first, then the others one by one.
  const watcher = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        const figure = figures.find((f) => f.element === entry.target);
        if (entry.isIntersecting && figure && !figure.theme) figure.draw(theme());
      }
    },
    { rootMargin: "300px" }
  );
  function adopt(root) {
    figures = figures.filter((figure) => figure.element.isConnected);
    for (const element of root.querySelectorAll("figure")) {
      figures.push(new Figure(element));
      watcher.observe(element);
    }
  }
  const loaded = new Promise((resolve) => addEventListener("load", resolve));
  library.then(() => adopt(document));
  function drawNext() {
    const [next] = undrawn();
    if (next) {
      next.draw(theme());
      setTimeout(drawNext, 0);
    } else {
      document.documentElement.dataset.drawn = "all";
    }
  }
  Promise.all([library, loaded]).then(() => setTimeout(drawNext, 50));
  // A page of a run in progress replaces its sections, and tells of each.
  document.addEventListener("replaced", (event) => {
    library.then(() => {
      adopt(event.target);
      setTimeout(drawNext, 50);
    });
  });

  document.addEventListener("removed", (event) => {
    for (const figure of figures.filter((f) => event.target.contains(f.element))) {
      watcher.unobserve(figure.element);
      figure.plots.forEach((plot) => Plotly.purge(plot));
    }
  });

  function redraw() {
    for (const figure of figures) if (figure.theme && !closed(figure)) figure.draw(theme());
  }
  dark.addEventListener("change", redraw);
  let width = innerWidth;
  let waiting = 0;
  addEventListener("resize", () => {
    if (innerWidth === width) return; // a phone's address bar appears or disappears
    width = innerWidth;
    clearTimeout(waiting);
    waiting = setTimeout(redraw, 150);
  });

  // What the reader has not opened is not printed.
  addEventListener("beforeprint", () => {
    for (const figure of figures.filter((figure) => !closed(figure))) {
      const columns = Number(getComputedStyle(figure.element.querySelector(".panels")).getPropertyValue("--columns"));
      figure.draw("light", Math.floor((PRINT_WIDTH - GAP * (columns - 1)) / columns), PRINT_SCALE);
    }
  });
  addEventListener("afterprint", redraw);

  // A figure in what was closed has had no width.
  document.addEventListener("toggle", (event) => {
    if (event.target.open) for (const figure of undrawn()) figure.draw(theme());
  }, true);
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
