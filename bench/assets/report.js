// Draws the figures of the report: each series has its own x, so uPlot runs in its mode 2 and the drawing of points and
// lines is done here. The data are in the element #figures; marks: 0 points, 1 line, 2 dashed.
(() => {
  "use strict";
  const POINTS = 0, DASHED = 2;
  const PALETTE = 8;
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const plots = [];

  const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const dark = matchMedia("(prefers-color-scheme: dark)");
  // Beyond the palette hues follow the golden angle, which never repeats.
  const colour = group => group < PALETTE
    ? css("--c" + group)
    : `hsl(${(group * 137.508) % 360} 60% ${dark.matches ? 65 : 42}%)`;
  const number = v => Number(v.toPrecision(6)).toString();

  function stroke(ctx, mark, group, ratio) {
    ctx.strokeStyle = ctx.fillStyle = colour(group);
    // A model is darker (lighter in the dark) than the data of its group, so that both are seen where they agree. A browser
    // without color-mix ignores this.
    if (mark !== POINTS) ctx.strokeStyle = ctx.fillStyle = `color-mix(in srgb, ${colour(group)} 65%, ${css("--ink")})`;
    ctx.lineWidth = (mark === DASHED ? 1.5 : 1.75) * ratio;
    ctx.lineJoin = "round";
    ctx.setLineDash(mark === DASHED ? [5 * ratio, 4 * ratio] : []);
  }

  function drawPoints(ctx, xs, ys, radius) {
    ctx.globalAlpha = xs.length > 400 ? 0.6 : 0.8;
    ctx.beginPath();
    for (let i = 0; i < xs.length; i++) {
      ctx.moveTo(xs[i] + radius, ys[i]);
      ctx.arc(xs[i], ys[i], radius, 0, 2 * Math.PI);
    }
    ctx.fill();
    ctx.globalAlpha = 1;
  }

  // A null in ys breaks the line; a value alone between two breaks is drawn as a dot, or it would not be seen.
  function drawLine(ctx, xs, ys, radius) {
    const alone = [[], []];
    ctx.beginPath();
    for (let i = 0; i < xs.length; i++) {
      if (ys[i] == null) continue;
      const first = i === 0 || ys[i - 1] == null;
      const last = i === xs.length - 1 || ys[i + 1] == null;
      if (first && last) { alone[0].push(xs[i]); alone[1].push(ys[i]); }
      else if (first) ctx.moveTo(xs[i], ys[i]);
      else ctx.lineTo(xs[i], ys[i]);
    }
    ctx.stroke();
    if (alone[0].length) drawPoints(ctx, alone[0], alone[1], radius);
  }

  function paths(series) {
    return (u, index) => {
      const ctx = u.ctx, ratio = uPlot.pxRatio, { left, top, width, height } = u.bbox;
      const [x, y] = u.data[index];
      const xs = x.map(v => u.valToPos(v, "x", true));
      const ys = y.map(v => v == null ? null : u.valToPos(v, "y", true));
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
      stroke(ctx, series.mark, series.group, ratio);
      if (series.mark === POINTS) drawPoints(ctx, xs, ys, (x.length > 400 ? 1.6 : 2.6) * ratio);
      else drawLine(ctx, xs, ys, 1.6 * ratio);
      ctx.restore();
      return null; // nothing for uPlot to cache: drawn anew at each zoom
    };
  }

  // Range with a margin; also for a single value and for no value at all.
  function padded(u, min, max) {
    if (min == null || max == null) return [0, 1];
    const span = max - min;
    const pad = span > 0 ? 0.04 * span : Math.abs(max) * 0.1 || 1;
    return [min - pad, max + pad];
  }

  function axis(label, vertical) {
    return {
      label, labelSize: 22, labelFont: "13px system-ui, sans-serif", font: "12px system-ui, sans-serif",
      stroke: () => css("--faint"),
      grid: { stroke: () => css("--grid"), width: 1 },
      ticks: { stroke: () => css("--rule"), width: 1, size: 5 },
      ...(vertical ? { size: (u, values) => 14 + 7 * Math.max(3, ...(values || []).map(v => (v || "").length)) } : { size: 34, space: 60 }),
    };
  }

  function zoom(u, factor, cx, cy) {
    u.batch(() => {
      for (const [key, at] of [["x", cx], ["y", cy]]) {
        const { min, max } = u.scales[key];
        if (factor == null) u.setScale(key, { min: null, max: null });
        else u.setScale(key, { min: at - (at - min) * factor, max: at + (max - at) * factor });
      }
    });
  }
  const middle = (u, key) => (u.scales[key].min + u.scales[key].max) / 2;

  // Two fingers zoom and move; one finger scrolls the page.
  function pinch(u) {
    let start = null;
    const spot = touches => {
      const box = u.over.getBoundingClientRect();
      const [a, b] = touches;
      const x = (a.clientX + b.clientX) / 2 - box.left, y = (a.clientY + b.clientY) / 2 - box.top;
      return { x, y, gap: Math.max(20, Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY)) };
    };
    u.over.addEventListener("touchstart", e => {
      if (e.touches.length !== 2) return;
      e.preventDefault();
      const s = spot(e.touches);
      start = { ...s, vx: u.posToVal(s.x, "x"), vy: u.posToVal(s.y, "y"), sx: u.scales.x.max - u.scales.x.min, sy: u.scales.y.max - u.scales.y.min };
    }, { passive: false });
    u.over.addEventListener("touchmove", e => {
      if (!start || e.touches.length !== 2) return;
      e.preventDefault();
      const now = spot(e.touches), factor = start.gap / now.gap;
      const sx = start.sx * factor, sy = start.sy * factor;
      const minX = start.vx - sx * now.x / u.over.clientWidth, maxY = start.vy + sy * now.y / u.over.clientHeight;
      u.batch(() => {
        u.setScale("x", { min: minX, max: minX + sx });
        u.setScale("y", { min: maxY - sy, max: maxY });
      });
    }, { passive: false });
    u.over.addEventListener("touchend", () => { start = null; });
  }

  // Says the value that is drawn nearest to the pointer.
  function readout(u, figure, order) {
    const tip = document.createElement("div"), dot = document.createElement("div");
    tip.className = "tip"; dot.className = "dot";
    tip.hidden = dot.hidden = true;
    u.over.append(dot, tip);
    const hide = () => { tip.hidden = dot.hidden = true; };
    u.over.addEventListener("mouseleave", hide);
    u.over.addEventListener("mousemove", e => {
      const box = u.over.getBoundingClientRect();
      const mx = e.clientX - box.left, my = e.clientY - box.top;
      let best = null, distance = 40 * 40;
      order.forEach((s, k) => {
        if (!u.series[k + 1].show) return;
        const { x, y } = figure.series[s];
        for (let i = 0; i < x.length; i++) {
          if (y[i] == null) continue;
          const px = u.valToPos(x[i], "x"), py = u.valToPos(y[i], "y");
          const d = (px - mx) ** 2 + (py - my) ** 2;
          if (d < distance && px >= 0 && py >= 0 && px <= box.width && py <= box.height) { distance = d; best = { s, i, px, py }; }
        }
      });
      if (!best) return hide();
      const series = figure.series[best.s];
      tip.replaceChildren();
      for (const line of [series.name, `${figure.x_label}: ${number(series.x[best.i])}`, `${figure.y_label}: ${number(series.y[best.i])}`]) {
        const row = document.createElement("div");
        row.textContent = line;
        tip.append(row);
      }
      tip.hidden = dot.hidden = false;
      dot.style.left = best.px + "px"; dot.style.top = best.py + "px";
      const right = best.px > box.width / 2;
      tip.style.left = right ? "" : best.px + 12 + "px";
      tip.style.right = right ? box.width - best.px + 12 + "px" : "";
      tip.style.top = Math.min(best.py + 8, box.height - 60) + "px";
    });
  }

  function button(text, label, act) {
    const b = document.createElement("button");
    b.type = "button"; b.textContent = text; b.title = label;
    b.setAttribute("aria-label", label);
    b.addEventListener("click", act);
    return b;
  }

  function swatch(canvas, series) {
    const ratio = devicePixelRatio || 1, ctx = canvas.getContext("2d");
    canvas.width = 24 * ratio; canvas.height = 10 * ratio;
    stroke(ctx, series.mark, series.group, ratio);
    if (series.mark === POINTS) drawPoints(ctx, [5, 12, 19].map(v => v * ratio), [6, 3, 6].map(v => v * ratio), 2.4 * ratio);
    else drawLine(ctx, [0, 24 * ratio], [5 * ratio, 5 * ratio], 1);
  }

  function legend(holder, u, figure, order) {
    const keys = document.createElement("div"), swatches = [];
    keys.className = "keys";
    figure.series.forEach((series, s) => {
      const index = order.indexOf(s) + 1;
      const b = button(series.name, `show or hide ${series.name}`, () => {
        const show = !u.series[index].show;
        b.setAttribute("aria-pressed", show);
        u.setSeries(index, { show });
      });
      b.setAttribute("aria-pressed", "true");
      const canvas = document.createElement("canvas");
      swatch(canvas, series);
      swatches.push(() => swatch(canvas, series));
      b.prepend(canvas);
      keys.append(b);
    });
    const zooms = document.createElement("span");
    zooms.className = "zoom";
    zooms.append(
      button("+", "zoom in", () => zoom(u, 0.6, middle(u, "x"), middle(u, "y"))),
      button("−", "zoom out", () => zoom(u, 1 / 0.6, middle(u, "x"), middle(u, "y"))),
      button("all", "show everything", () => zoom(u, null)));
    keys.append(zooms);
    holder.before(keys);
    return swatches;
  }

  const height = width => Math.round(Math.min(420, Math.max(260, width * 0.62)));

  function draw(holder) {
    const figure = figures[Number(holder.dataset.figure)];
    // Points lie below the models; within a kind the given order holds.
    const layer = [0, 2, 1];
    const order = figure.series.map((_, s) => s).sort((a, b) => layer[figure.series[a].mark] - layer[figure.series[b].mark] || a - b);
    const facets = [{ scale: "x", auto: true }, { scale: "y", auto: true }];
    const width = holder.clientWidth;
    const u = new uPlot({
      mode: 2, width, height: height(width), legend: { show: false }, padding: [10, 14, 0, 0],
      cursor: {
        dataIdx: () => null, // the nearest value is sought in both directions by readout()
        drag: { x: true, y: true, uni: 25, dist: 6 },
        bind: { dblclick: () => () => zoom(u, null) },
      },
      scales: { x: { time: false, range: padded }, y: { range: padded } },
      axes: [axis(figure.x_label, false), axis(figure.y_label, true)],
      series: [null, ...order.map(s => ({ label: figure.series[s].name, facets, paths: paths(figure.series[s]) }))],
    }, [null, ...order.map(s => [figure.series[s].x, figure.series[s].y])], holder);
    u.over.addEventListener("wheel", e => {
      if (!e.ctrlKey && !e.metaKey) return; // without a key the page scrolls
      e.preventDefault();
      const box = u.over.getBoundingClientRect();
      zoom(u, e.deltaY < 0 ? 0.8 : 1.25, u.posToVal(e.clientX - box.left, "x"), u.posToVal(e.clientY - box.top, "y"));
    }, { passive: false });
    pinch(u);
    readout(u, figure, order);
    plots.push({ u, swatches: legend(holder, u, figure, order) });
    new ResizeObserver(() => {
      const now = holder.clientWidth;
      if (now > 0 && now !== u.width) u.setSize({ width: now, height: height(now) });
    }).observe(holder);
  }

  // A figure is drawn when it comes near the window: a report may hold many.
  const waiting = new Set(document.querySelectorAll(".plot"));
  const now = holder => { if (waiting.delete(holder)) draw(holder); };
  const seen = new IntersectionObserver(entries => entries.forEach(e => {
    if (e.isIntersecting) { seen.unobserve(e.target); now(e.target); }
  }), { rootMargin: "600px" });
  waiting.forEach(holder => seen.observe(holder));
  addEventListener("beforeprint", () => waiting.forEach(now));
  dark.addEventListener("change", () => plots.forEach(({ u, swatches }) => {
    swatches.forEach(paint => paint());
    u.redraw(false, true);
  }));
})();
