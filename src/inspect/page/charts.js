// The map of pages, and histograms.

function pageMap() {
  const map = data.map;
  if (!map || map.pages === 0) return;
  const view = new DataView(block(map.data).buffer);
  const bars = [];
  for (let at = 0; at < view.byteLength; at += 22) {
    const field = (k) => view.getUint32(at + 4 * k, true);
    bars.push({ stored: field(0), raw: field(1), points: field(2), nodes: field(3), id: field(4),
      level: view.getUint8(at + 20), isMedia: view.getUint8(at + 21) === 1 });
  }
  const highest = bars.reduce((most, b) => Math.max(most, b.stored), 1);
  const canvas = byId("map");
  let at = -1;
  const several = map.each > 1 ? ` A bar is of ${map.each} of them.` : "";
  byId("pages-title").textContent = map.name === "page" ? "Pages" : "Chunks";
  byId("pages-help").textContent = `${count(map.pages)} ${map.name}s in the order of the file; heights are stored bytes, ` +
    `${count(highest)} the most.${several} Point at a bar, or go along with the arrow keys.`;
  const legend = byId("map-legend");
  for (const [isMedia, name, colour] of [[false, "surfels", "--surfels"], [true, "lvoxels", "--media"]]) {
    if (!bars.some((b) => b.isMedia === isMedia)) continue;
    const mark = document.createElement("i");
    mark.style.background = `var(${colour})`;
    legend.append(mark, name);
  }

  function draw() {
    const [width, height] = sized(canvas);
    const context = canvas.getContext("2d");
    const colours = [styled("--surfels"), styled("--media"), styled("--text"), styled("--line")];
    context.clearRect(0, 0, width, height);
    const step = width / bars.length;
    const gap = step > 5 ? 1 : 0;
    bars.forEach((bar, i) => {
      const x = Math.floor(i * step);
      const h = Math.max(1, (bar.stored / highest) * (height - 4));
      context.fillStyle = colours[i === at ? 2 : bar.isMedia ? 1 : 0];
      context.fillRect(x, height - 1 - h, Math.max(1, Math.ceil((i + 1) * step) - x - gap), h);
    });
    context.fillStyle = colours[3];
    context.fillRect(0, height - 1, width, 1);
  }

  function tell(i) {
    at = Math.max(0, Math.min(bars.length - 1, i));
    const bar = bars[at];
    const kind = bar.isMedia ? "lvoxels" : "surfels";
    const parts = [`${map.name} ${bar.id} of ${kind}`, `${count(bar.stored)} bytes stored, ${count(bar.raw)} raw`,
      `ratio ${(bar.raw / Math.max(1, bar.stored)).toFixed(2)}`, `${count(bar.points)} ${kind}`];
    if (bar.nodes > 0) parts.push(`${count(bar.nodes)} nodes`);
    if (bar.level !== 255) parts.push(`its first node at level ${bar.level}`);
    byId("bar").textContent = parts.join(" · ");
    draw();
  }
  const under = (event) => Math.floor((event.offsetX / canvas.clientWidth) * bars.length);
  canvas.addEventListener("pointermove", (event) => tell(under(event)));
  canvas.addEventListener("pointerdown", (event) => tell(under(event)));
  canvas.addEventListener("keydown", (event) => {
    const to = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: bars.length - 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    tell(to);
  });
  byId("pages").hidden = false;
  whenLooksChange(draw);
}

const BINS = 40;

/** Draws a histogram over the logarithm of values, those of each level in a shade of its own. */
function histogram(title, unit, values, levels) {
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  const canvas = document.createElement("canvas");
  canvas.className = "chart";
  canvas.setAttribute("role", "img");
  const note = document.createElement("p");
  note.className = "note";
  figure.append(caption, canvas, note);
  caption.textContent = title;
  let [from, to, zeros] = [Infinity, -Infinity, 0];
  for (const v of values) {
    if (v > 0 && Number.isFinite(v)) {
      from = Math.min(from, v);
      to = Math.max(to, v);
    } else zeros++;
  }
  const isFlat = !(to > from);
  const [low, high] = isFlat ? [Math.log10(from) - 0.5, Math.log10(from) + 0.5] : [Math.log10(from), Math.log10(to)];
  const names = [...new Set(levels)].sort((a, b) => a - b);
  const bins = Array.from({ length: BINS }, () => new Array(names.length).fill(0));
  const place = new Map(names.map((name, i) => [name, i]));
  values.forEach((v, i) => {
    if (!(v > 0 && Number.isFinite(v))) return;
    const bin = Math.floor(((Math.log10(v) - low) / (high - low)) * BINS);
    bins[Math.max(0, Math.min(BINS - 1, bin))][place.get(levels[i])]++;
  });
  const most = Math.max(1, ...bins.map((b) => b.reduce((a, c) => a + c, 0)));
  const parts = [Number.isFinite(from) ? `${number(from, 3)} to ${number(to, 3)}${unit}` : "none above 0"];
  if (zeros > 0) parts.push(`${count(zeros)} at 0`);
  if (names.length > 1) parts.push(`levels ${names[0]} to ${names[names.length - 1]}, the finest at the bottom`);
  note.textContent = parts.join("; ");
  canvas.setAttribute("aria-label", `${title}: ${note.textContent}`);
  byId("charts").append(figure);
  const [width, height] = sized(canvas);
  const context = canvas.getContext("2d");
  const base = styled(unit === " per unit of length" ? "--media" : "--surfels");
  context.fillStyle = base;
  bins.forEach((bin, i) => {
    let y = height - 1;
    bin.forEach((c, k) => {
      const h = (c / most) * (height - 6);
      context.globalAlpha = 1 - (0.65 * k) / Math.max(1, names.length);
      context.fillRect(Math.floor((i * width) / BINS), y - h, Math.ceil(width / BINS) - 1, h);
      y -= h;
    });
  });
  context.globalAlpha = 1;
  context.fillStyle = styled("--line");
  context.fillRect(0, height - 1, width, 1);
}

pageMap();
