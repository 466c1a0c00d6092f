// The layers of an image, and a probe that tells the values of a pixel as they are in the file.

const picture = data.picture;
const HALVES = Float32Array.from({ length: 65536 }, (_, code) => fromHalf(code));

/** Values of a channel. */
async function values(channel) {
  const planes = await inflated(channel.data);
  const n = picture.width * picture.height;
  if (channel.bits === 16) return Float32Array.from({ length: n }, (_, i) => HALVES[planes[i] | (planes[n + i] << 8)]);
  const bytes = new Uint8Array(4 * n);
  for (let k = 0; k < 4; k++) for (let i = 0; i < n; i++) bytes[4 * i + k] = planes[k * n + i];
  return new Float32Array(bytes.buffer);
}

/** The least and the greatest finite value. */
function range(list) {
  let [from, to] = [Infinity, -Infinity];
  for (const v of list) {
    if (Number.isFinite(v)) {
      from = Math.min(from, v);
      to = Math.max(to, v);
    }
  }
  return from <= to ? [from, to] : [0, 1];
}

async function showPicture() {
  const canvas = byId("pixels");
  canvas.width = picture.width;
  canvas.height = picture.height;
  for (const layer of picture.layers) {
    for (const channel of layer.channels) channel.values = await values(channel);
    const option = document.createElement("option");
    option.textContent = (layer.name || "beauty") + " (" + layer.channels.map((c) => c.name).join(" ") + ")";
    byId("layer").append(option);
  }
  byId("picture-help").textContent = (picture.stride > 1
    ? `The page holds one pixel of ${picture.stride} along each side. ` : "The page holds every pixel. ") +
    "Point at the image, or go over it with the arrow keys, for the values of a pixel, which are those of the file.";
  const context = canvas.getContext("2d");
  let at = [0, 0];

  function draw() {
    const layer = picture.layers[byId("layer").selectedIndex];
    const stops = Number(byId("stops").value);
    byId("stops-value").textContent = stopsText(stops);
    const named = (...names) => names.map((n) => layer.channels.find((c) => c.name === n));
    const image = context.createImageData(picture.width, picture.height);
    const colours = named("R", "G", "B");
    const axes = named("X", "Y", "Z");
    const n = picture.width * picture.height;
    // How to show three values: light by its exposure, directions and places by where they lie between their ends.
    let look;
    let from = colours;
    if (colours.every(Boolean)) {
      const exposure = picture.exposure * 2 ** stops;
      look = () => (v) => shown(v, exposure);
    } else {
      from = axes.every(Boolean) ? axes : Array(3).fill(layer.channels[0]);
      look = (channel) => {
        const [low, high] = axes.every(Boolean) && layer.name === "normal" ? [-1, 1] : range(channel.values);
        const gain = 2 ** stops / (high - low || 1);
        return (v) => (Number.isNaN(v) ? 0 : Math.max(0, Math.min(255, (v - low) * gain * 255)));
      };
    }
    from.forEach((channel, c) => {
      const show = look(channel);
      for (let i = 0; i < n; i++) image.data[4 * i + c] = show(channel.values[i]);
    });
    for (let i = 0; i < n; i++) image.data[4 * i + 3] = 255;
    context.putImageData(image, 0, 0);
  }

  /** The values of a pixel that the page holds, by the full names of channels. */
  function probe(x, y) {
    const found = [];
    for (const layer of picture.layers) {
      for (const c of layer.channels) {
        found.push([(layer.name ? layer.name + "." : "") + c.name, c.values[y * picture.width + x]]);
      }
    }
    return found;
  }

  function tell(x, y) {
    at = [Math.max(0, Math.min(picture.width - 1, x)), Math.max(0, Math.min(picture.height - 1, y))];
    const place = [picture.x0 + at[0] * picture.stride, picture.y0 + at[1] * picture.stride];
    const rows = probe(...at).map(([name, v]) => [name, number(v, 9)]);
    showPairs(byId("probed"), [["pixel", place.join(", ")], ...rows]);
  }
  const under = (event) => [Math.floor((event.offsetX / canvas.clientWidth) * picture.width),
    Math.floor((event.offsetY / canvas.clientHeight) * picture.height)];
  canvas.addEventListener("pointermove", (event) => tell(...under(event)));
  canvas.addEventListener("pointerdown", (event) => tell(...under(event)));
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!step) return;
    event.preventDefault();
    tell(at[0] + step[0], at[1] + step[1]);
  });
  function zoom() {
    const to = byId("zoom").value;
    canvas.className = to === "fit" ? "fit" : "";
    canvas.style.width = to === "fit" ? "" : (to * picture.width) / (devicePixelRatio || 1) + "px";
  }
  byId("layer").addEventListener("change", draw);
  byId("stops").addEventListener("input", draw);
  byId("zoom").addEventListener("change", zoom);
  byId("picture").hidden = false;
  zoom();
  draw();
  if (isProbed) {
    const [x, y] = location.hash.split("=")[1].split(",").map(Number);
    tell(x, y);
    const colour = context.getImageData(x, y, 1, 1).data;
    const text = probe(x, y).map(([name, v]) => [name, number(v, 9)]);
    leave({ layers: picture.layers.map((l) => l.name), stride: picture.stride, values: Object.fromEntries(text),
      shown: [...colour].slice(0, 3) });
  }
}

showPicture();
