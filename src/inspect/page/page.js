// What all scripts of the page share. Names and numbers of the file come into the page as text only.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);

/** Bytes of a block of data. */
function block(number) {
  const text = atob(byId("block" + number).textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

/** Bytes of a block in the format of zlib. */
async function inflated(number) {
  const stream = new Blob([block(number)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** A 16-bit float. */
function fromHalf(code) {
  const sign = code & 0x8000 ? -1 : 1;
  const exponent = (code >> 10) & 31;
  const fraction = code & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1024 + fraction) * 2 ** (exponent - 25);
}

/** What a display shows of a radiance: the tone map of lvox, 0 to 255. */
function shown(radiance, exposure) {
  const v = radiance * exposure;
  return v > 0 ? Math.floor(Math.min(v, 1) ** (1 / 2.2) * 255 + 0.5) : 0;
}

/** A number with the digits that it has. */
function number(v, digits = 6) {
  if (!Number.isFinite(v)) return Number.isNaN(v) ? "not a number" : v > 0 ? "infinite" : "-infinite";
  return String(Number(v.toPrecision(digits)));
}

const count = (n) => n.toLocaleString("en");

/** Fills an element with a table of names and values. */
function showPairs(element, pairs) {
  const table = document.createElement("table");
  table.className = "pairs";
  for (const [name, value] of pairs) {
    const row = table.insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    head.textContent = name;
    row.append(head);
    row.insertCell().textContent = value;
  }
  element.replaceChildren(table);
}

/** Stops as text. */
const stopsText = (stops) => (stops > 0 ? "+" : "") + stops + " EV";

/** A colour of the style. */
const styled = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Calls back now and whenever the colours or the width of the page change. */
function whenLooksChange(draw) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  addEventListener("resize", draw);
  draw();
}

/** A canvas of the size that it has on the page; gives width and height in its own pixels. */
function sized(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  return [width, height];
}

/** For tests: with #probe in the address, what was found is left in the page as JSON. */
const isProbed = location.hash.startsWith("#probe");
function leave(found) {
  const element = document.createElement("pre");
  element.id = "probe";
  element.textContent = JSON.stringify(found);
  document.body.append(element);
}
