// Draws the page's figures, and draws them again in other colours when the scheme changes.
(() => {
  "use strict";
  const read = (element) => JSON.parse(element.textContent);
  const templates = {
    light: read(document.getElementById("template-light")),
    dark: read(document.getElementById("template-dark")),
  };
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  const current = () => templates[scheme.matches ? "dark" : "light"];
  const config = { responsive: true, displaylogo: false };

  const plots = [...document.querySelectorAll(".drawing")];
  const drawn = plots.map((plot) => {
    const data = plot.querySelector("script");
    const { data: traces, layout, frames } = read(data);
    data.remove();
    return Plotly.newPlot(plot, {
      data: traces,
      layout: { ...layout, template: current(), autosize: true },
      frames: frames || [],
      config,
    });
  });
  // An animation that is paused ends with a rejection without a reason; that is no error.
  window.addEventListener("unhandledrejection", (event) => {
    if (event.reason === undefined) event.preventDefault();
  });
  Promise.all(drawn).then(() => document.documentElement.classList.add("drawn"));

  const dress = (template) => plots.forEach((plot) => Plotly.relayout(plot, { template }));
  scheme.addEventListener("change", () => dress(current()));

  // Paper is white and no larger than it is; the screen's size comes back afterwards.
  const resize = (plot, template, width, height) => {
    plot.style.height = `${height}px`;
    Plotly.relayout(plot, { template, width, height, autosize: width === null });
  };
  const heights = plots.map((plot) => parseFloat(plot.style.height));
  window.addEventListener("beforeprint", () =>
    plots.forEach((plot, i) => resize(plot, templates.light, 680, Math.min(heights[i], 880))),
  );
  window.addEventListener("afterprint", () =>
    plots.forEach((plot, i) => resize(plot, current(), null, heights[i])),
  );
})();
