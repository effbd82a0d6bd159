// Draws the page's figures as they come into view, and again in other colours when the scheme
// changes; unfolds chapters; moves animations.
(() => {
  "use strict";
  const root = document.documentElement;
  const read = (element) => JSON.parse(element.textContent);
  const templates = {
    light: read(document.getElementById("template-light")),
    dark: read(document.getElementById("template-dark")),
  };
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  // A page that shows this one in a frame says which colours it has: in the address, or later.
  const takeTheme = (theme) => {
    const given = theme === "dark" || theme === "light" ? theme : "";
    root.style.colorScheme = given;
    if (given) root.dataset.theme = given;
    else delete root.dataset.theme;
  };
  takeTheme(new URLSearchParams(window.location.search).get("theme"));
  const current = () => templates[root.dataset.theme || (scheme.matches ? "dark" : "light")];
  const config = { responsive: true, displaylogo: false };

  // Plotly's script is packed into the page, or lies beside the pages of a site.
  const unpacked = (async () => {
    const packed = document.getElementById("plotly");
    if (!packed || !packed.textContent) return;
    const bytes = Uint8Array.from(atob(packed.textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    packed.remove();
  })();

  // Figures in folded chapters have no size; they are drawn when their chapter unfolds.
  const plots = [...document.querySelectorAll(".drawing")];
  const heights = new Map(plots.map((plot) => [plot, parseFloat(plot.style.height)]));
  const isShown = (plot) => plot.closest("details:not([open])") === null;
  const begun = new Set();
  const done = new Set();
  const tell = () =>
    root.classList.toggle("drawn", plots.filter(isShown).every((plot) => done.has(plot)));

  const draw = async (plot) => {
    begun.add(plot);
    const packed = plot.querySelector("script");
    const { data, layout, frames } = read(packed);
    packed.remove();
    await Plotly.newPlot(plot, {
      data,
      layout: { ...layout, template: current(), autosize: true },
      frames: frames || [],
      config,
    });
    if (frames && frames.length) addPlayer(plot, frames, layout.meta);
    done.add(plot);
  };
  const drawShown = async () => {
    tell();
    await unpacked;
    await Promise.all(plots.filter((plot) => isShown(plot) && !begun.has(plot)).map(draw));
    tell();
  };
  drawShown().catch((error) => {
    const said = document.createElement("p");
    said.textContent = `This browser cannot draw the figures (${error}); a newer one can.`;
    document.querySelector("main").prepend(said);
  });

  // Chapters: by their heads, all at once, and by links to them.
  const chapters = [...document.querySelectorAll("details.section")];
  const all = document.getElementById("open-all");
  const areOpen = () => chapters.every((chapter) => chapter.open);
  const label = () => {
    all.textContent = areOpen() ? "Fold all" : "Unfold all";
    all.setAttribute("aria-pressed", String(areOpen()));
  };
  chapters.forEach((chapter) =>
    chapter.addEventListener("toggle", () => {
      label();
      drawShown();
    }),
  );
  all.addEventListener("click", () => {
    const open = !areOpen();
    chapters.forEach((chapter) => (chapter.open = open));
  });
  const unfold = () => {
    const target = window.location.hash && document.querySelector(window.location.hash);
    const chapter = target && target.closest("details");
    if (!chapter) return;
    chapter.open = true;
    chapter.scrollIntoView();
  };
  window.addEventListener("hashchange", unfold);
  document.querySelector("nav").addEventListener("click", (event) => {
    if (event.target.hash && event.target.hash === window.location.hash) unfold();
  });
  unfold();
  label();

  // Buttons and a slider of the browser's own, which keys work: Tab, Space, arrows.
  const make = (tag, properties, parent) => {
    const element = Object.assign(document.createElement(tag), properties);
    parent.append(element);
    return element;
  };
  function addPlayer(plot, frames, { times, pause }) {
    const last = frames.length - 1;
    const player = make("div", { className: "player", role: "group" }, plot.parentElement);
    player.setAttribute("aria-label", "Animation");
    plot.after(player);
    const play = make("button", { type: "button" }, player);
    const back = make("button", { type: "button", textContent: "◂ Back" }, player);
    const on = make("button", { type: "button", textContent: "Step ▸" }, player);
    const slider = make("input", { type: "range", min: 0, max: last, step: 1, value: 0 }, player);
    slider.setAttribute("aria-label", "Time");
    const time = make("output", {}, player);
    let at = 0;
    let playing = false;
    const show = (k) => {
      at = (k + frames.length) % frames.length;
      slider.value = at;
      time.textContent = `${times[at].toFixed(2)} s`;
      slider.setAttribute("aria-valuetext", time.textContent);
      const still = { frame: { duration: 0, redraw: true }, transition: { duration: 0 } };
      return Plotly.animate(plot, [frames[at].name], { ...still, mode: "immediate" });
    };
    const name = () => {
      play.textContent = playing ? "❚❚ Pause" : "▶ Play";
    };
    const stop = () => {
      playing = false;
      name();
    };
    const run = async () => {
      // In real time; who asks for less motion sees single pictures.
      const wait = calm.matches ? 700 : 0;
      let start = performance.now() - at * pause;
      while (playing) {
        await new Promise((next) => (wait ? setTimeout(next, wait) : requestAnimationFrame(next)));
        if (!playing) return;
        const k = Math.floor((performance.now() - start) / pause);
        const skip = Math.max(1, Math.round(frames.length / 12));
        if (wait) await show(at + skip > last ? 0 : at + skip);
        else if (k > last) start = performance.now();
        else if (k !== at) await show(k);
      }
    };
    play.addEventListener("click", () => {
      playing = !playing;
      name();
      if (playing) run();
    });
    const step = (by) => () => {
      stop();
      show(at + by);
    };
    back.addEventListener("click", step(-1));
    on.addEventListener("click", step(1));
    slider.addEventListener("input", () => {
      stop();
      show(Number(slider.value));
    });
    name();
    time.textContent = `${times[0].toFixed(2)} s`;
    slider.setAttribute("aria-valuetext", time.textContent);
  }
  // An animation that is paused ends with a rejection without a reason; that is no error.
  window.addEventListener("unhandledrejection", (event) => {
    if (event.reason === undefined) event.preventDefault();
  });

  const visible = () => [...done].filter(isShown);
  const dress = (template) => done.forEach((plot) => Plotly.relayout(plot, { template }));
  scheme.addEventListener("change", () => dress(current()));
  window.addEventListener("message", (event) => {
    if (event.source !== window.parent || typeof event.data?.theme !== "string") return;
    takeTheme(event.data.theme);
    dress(current());
  });

  // Paper is white and no larger than it is; the screen's size comes back afterwards.
  const resize = (plot, template, width, height) => {
    plot.style.height = `${height}px`;
    Plotly.relayout(plot, { template, width, height, autosize: width === null });
  };
  const onPaper = (plot) => Math.min(heights.get(plot), Number(plot.dataset.paper));
  window.addEventListener("beforeprint", () =>
    visible().forEach((plot) => resize(plot, templates.light, 680, onPaper(plot))),
  );
  window.addEventListener("afterprint", () =>
    visible().forEach((plot) => resize(plot, current(), null, heights.get(plot))),
  );
})();
