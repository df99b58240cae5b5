"use strict";
(() => {
  const shades = JSON.parse(document.getElementById("shades").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const PRINT_WIDTH = 680; // of an A4 page between its margins [px]
  const GAP = 6; // between panels [px]
  const PRINT_SCALE = 0.8; // of the height of panels, as in the style sheet
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
        }
        panel.layout.width = width || this.plots[k].clientWidth;
        panel.layout.height *= scale;
        Plotly.react(this.plots[k], panel.data, panel.layout, config);
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

  // Names in the data are escaped a second time, since Plotly interprets some markup.
  function escaped(text) {
    return text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  }

  const theme = () => (dark.matches ? "dark" : "light");
  let figures = [];
  const undrawn = () => figures.filter((figure) => !figure.theme);

  // Visible figures are drawn first, then the others one by one.
  const watcher = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        const figure = figures.find((f) => f.element === entry.target);
        if (entry.isIntersecting && !figure.theme) figure.draw(theme());
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
  adopt(document);
  function drawNext() {
    const [next] = undrawn();
    if (next) {
      next.draw(theme());
      setTimeout(drawNext, 0);
    } else {
      document.documentElement.dataset.drawn = "all";
    }
  }
  addEventListener("load", () => setTimeout(drawNext, 50));
  // A page of a run in progress replaces its sections, and tells of each.
  document.addEventListener("replaced", (event) => {
    adopt(event.target);
    setTimeout(drawNext, 50);
  });

  document.addEventListener("removed", (event) => {
    for (const figure of figures.filter((f) => event.target.contains(f.element))) {
      watcher.unobserve(figure.element);
      figure.plots.forEach((plot) => Plotly.purge(plot));
    }
  });

  function redraw() {
    for (const figure of figures) if (figure.theme) figure.draw(theme());
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

  addEventListener("beforeprint", () => {
    for (const details of document.querySelectorAll("details")) details.open = true;
    for (const figure of figures) {
      const columns = Number(getComputedStyle(figure.element.querySelector(".panels")).getPropertyValue("--columns"));
      figure.draw("light", Math.floor((PRINT_WIDTH - GAP * (columns - 1)) / columns), PRINT_SCALE);
    }
  });
  addEventListener("afterprint", redraw);
})();
