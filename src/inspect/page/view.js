// A view of points in WebGL2: nodes and surfels as disks, lvoxels as boxes that hide as much as they would.

const POINT_BYTES = 14;
const MODES = ["radiance", "normal", "radius", "page", "volume", "sigma_t"];

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
layout(location = 0) in uvec3 a_place;
layout(location = 1) in uvec2 a_shape;
layout(location = 2) in uint a_size;
layout(location = 3) in uvec2 a_light;
layout(location = 4) in uint a_page;
uniform mat4 u_clip_from_scene;
uniform vec3 u_min, u_extent, u_eye, u_right, u_up;
uniform vec2 u_unit;          // of radii and of sigma_t
uniform float u_light;        // radiance times exposure
uniform float u_grow, u_ball; // factor on sizes; radius of a ball as large as an lvoxel of level 0, else 0
uniform float u_reach;        // from the middle of an lvoxel of level 0 to its farthest corner
uniform vec4 u_ranges;        // logarithms: radius from, to; sigma_t from, to
uniform int u_mode, u_volume;
uniform bool u_marked_only, u_backs;
uniform uint u_first;
flat out vec3 v_colour;
flat out float v_density;     // sigma_t of a box; negative for a disk
flat out vec3 v_centre;
flat out float v_scale;       // of a box: edges over those of level 0
out vec3 v_place;
flat out float v_behind;      // how much farther the rim is taken to be than the centre
flat out uint v_id;
out vec2 v_at;

vec3 unfolded(uvec2 code) {
  vec2 p = vec2(code) / 127.0 - 1.0;
  vec3 n = vec3(p, 1.0 - abs(p.x) - abs(p.y));
  float t = max(-n.z, 0.0);
  n.x += n.x >= 0.0 ? -t : t;
  n.y += n.y >= 0.0 ? -t : t;
  return normalize(n);
}
vec3 some_colour(uint k) {
  k = (k ^ 61u) ^ (k >> 16); k *= 9u; k ^= k >> 4; k *= 668265261u; k ^= k >> 15;
  return 0.25 + 0.65 * vec3(float(k & 255u), float((k >> 8) & 255u), float((k >> 16) & 255u)) / 255.0;
}
vec3 scale(float v, float from, float to) {
  float t = clamp((v - from) / max(to - from, 1e-6), 0.0, 1.0);
  return mix(mix(vec3(0.27, 0.0, 0.33), vec3(0.13, 0.57, 0.55), min(t * 2.0, 1.0)), vec3(0.99, 0.91, 0.14), max(t * 2.0 - 1.0, 0.0));
}
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  vec3 centre = u_min + vec3(a_place) / 65535.0 * u_extent;
  float size = unpackHalf2x16(a_size).x;
  bool is_ball = u_ball > 0.0;
  bool has_normal = !is_ball && a_shape.x != 255u;
  vec3 to_eye = normalize(u_eye - centre);
  vec3 normal = has_normal ? unfolded(a_shape) : to_eye;
  float radius = is_ball ? u_ball * exp2(float(a_shape.x)) : abs(size) * u_unit.x;
  bool is_back = dot(normal, u_eye - centre) < 0.0;
  v_id = u_first + uint(gl_InstanceID);
  v_at = corner;
  v_density = is_ball ? size * u_unit.y : -1.0;
  v_centre = centre;
  v_scale = is_ball ? exp2(float(a_shape.x)) * u_grow : 1.0;
  if ((u_marked_only && size >= 0.0) || (is_back && !u_backs)) {
    gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
    return;
  }
  uint bits = a_light.x | (a_light.y << 16);
  vec3 light = vec3(bits & 511u, (bits >> 9) & 511u, (bits >> 18) & 511u) * exp2(float(bits >> 27) - 24.0);
  if (u_mode == 1) v_colour = has_normal ? normal * 0.5 + 0.5 : vec3(0.5);
  else if (u_mode == 2) v_colour = scale(log(radius), u_ranges.x, u_ranges.y);
  else if (u_mode == 3) v_colour = some_colour(a_page * 2u + uint(is_ball));
  else if (u_mode == 4) v_colour = is_ball ? some_colour(uint(u_volume) + 7u) : vec3(0.55);
  else if (u_mode == 5) v_colour = is_ball ? scale(log(size * u_unit.y), u_ranges.z, u_ranges.w) : vec3(0.55);
  else v_colour = pow(min(light * u_light, 1.0), vec3(1.0 / 2.2));
  if (is_back) v_colour *= 0.35;
  vec3 right = u_right, up = u_up;
  if (has_normal) {
    float s = normal.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (s + normal.z);
    right = vec3(1.0 + s * normal.x * normal.x * a, s * normal.x * normal.y * a, -s * normal.x);
    up = vec3(normal.x * normal.y * a, s + normal.y * normal.y * a, -normal.y);
  }
  // So of disks that overlap the one is seen whose centre is nearest.
  vec4 front = u_clip_from_scene * vec4(centre, 1.0);
  vec4 back = u_clip_from_scene * vec4(centre - to_eye * radius * 0.5, 1.0);
  v_behind = is_ball ? 0.0 : (back.z / back.w - front.z / front.w) * 0.5;
  float reach = radius * u_grow;
  if (is_ball) {
    // A square before the eye that covers the sphere around the box, however near it is.
    vec3 way = normalize(abs(to_eye.y) < 0.9 ? cross(vec3(0.0, 1.0, 0.0), to_eye) : cross(vec3(1.0, 0.0, 0.0), to_eye));
    right = way;
    up = cross(to_eye, way);
    float r = u_reach * v_scale, d = distance(u_eye, centre);
    reach = r * d / sqrt(max(d * d - r * r, 0.01 * d * d));
  }
  v_place = centre + (right * corner.x + up * corner.y) * reach;
  gl_Position = u_clip_from_scene * vec4(v_place, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
flat in vec3 v_colour;
flat in float v_density;
flat in vec3 v_centre;
flat in float v_scale;
in vec3 v_place;
flat in float v_behind;
flat in uint v_id;
in vec2 v_at;
uniform bool u_pick, u_faces;
uniform mat4 u_clip_from_scene;
uniform vec3 u_eye;
uniform mat3 u_box_from_scene; // the box of an lvoxel of level 0 is -1 to 1
out vec4 colour;
float noise(uvec3 p) {
  uint k = p.x * 1597334673u ^ p.y * 3812015801u ^ p.z * 2798796415u;
  k ^= k >> 15; k *= 2246822519u; k ^= k >> 13; k *= 3266489917u; k ^= k >> 16;
  return float(k >> 8) / 16777216.0;
}
void main() {
  float light = 1.0;
  if (v_density < 0.0) {
    float r2 = dot(v_at, v_at);
    if (r2 > 1.0) discard;
    gl_FragDepth = clamp(gl_FragCoord.z + r2 * v_behind, 0.0, 1.0);
  } else {
    vec3 way = v_place - u_eye;
    vec3 from = u_box_from_scene * (u_eye - v_centre) / v_scale;
    vec3 along = u_box_from_scene * way / v_scale;
    along = mix(along, vec3(1e-12), lessThan(abs(along), vec3(1e-12)));
    vec3 a = (-1.0 - from) / along, b = (1.0 - from) / along;
    vec3 low = min(a, b), high = max(a, b);
    float near = max(max(low.x, low.y), max(low.z, 0.0)), far = min(min(high.x, high.y), high.z);
    if (far <= near) discard;
    // Of a medium as many pixels are drawn as light is taken on the way through the box.
    if (noise(uvec3(uvec2(gl_FragCoord.xy), v_id)) > 1.0 - exp(-v_density * (far - near) * length(way))) discard;
    vec4 at = u_clip_from_scene * vec4(u_eye + way * near, 1.0);
    gl_FragDepth = clamp(at.z / at.w * 0.5 + 0.5, 0.0, 1.0);
    if (u_faces) light = near == low.y ? 1.0 : near == low.x ? 0.85 : 0.7;
  }
  uint id = v_id + 1u;
  colour = u_pick ? vec4(float(id & 255u), float((id >> 8) & 255u), float((id >> 16) & 255u), 255.0) / 255.0 : vec4(v_colour * light, 1.0);
}`;

/** The points of the file, and what they mean. */
function loadPoints(view) {
  const bytes = block(view.points);
  const raw = new DataView(bytes.buffer);
  const total = bytes.length / POINT_BYTES;
  const pages = new Uint32Array(total);
  const runs = block(view.runs);
  let [at, page, filled] = [0, 0, 0];
  const varint = () => {
    let [v, factor] = [0, 1];
    for (;;) {
      const byte = runs[at++];
      v += (byte & 127) * factor;
      if (byte < 128) return v;
      factor *= 128;
    }
  };
  while (at < runs.length) {
    const code = varint();
    page += code % 2 ? -(code + 1) / 2 : code / 2;
    const n = varint();
    pages.fill(page, filled, filled + n);
    filled += n;
  }
  let first = 0;
  for (const group of view.groups) {
    group.first = first;
    first += group.count;
  }
  const { min, max, radius, sigma_t, radiance } = view.units;
  const extent = max.map((v, k) => v - min[k]);
  function record(group, i) {
    const o = i * POINT_BYTES;
    const size = fromHalf(raw.getUint16(o + 8, true));
    const bits = raw.getUint32(o + 10, true);
    const step = 2 ** ((bits >>> 27) - 24) * radiance;
    const [a, b] = [raw.getUint8(o + 6), raw.getUint8(o + 7)];
    const isMedia = group.kind === "lvoxel";
    let normal = null;
    if (!isMedia && a !== 255) {
      let [x, y] = [a / 127 - 1, b / 127 - 1];
      const z = 1 - Math.abs(x) - Math.abs(y);
      const t = Math.max(-z, 0);
      x += x >= 0 ? -t : t;
      y += y >= 0 ? -t : t;
      const length = Math.hypot(x, y, z);
      normal = [x / length, y / length, z / length];
    }
    return {
      place: min.map((v, k) => v + (raw.getUint16(o + 2 * k, true) / 65535) * extent[k]),
      normal,
      radius: isMedia ? group.ball * 2 ** a : Math.abs(size) * radius,
      level: isMedia ? a : group.level ?? 0,
      isMarked: !isMedia && (raw.getUint16(o + 8, true) & 0x8000) !== 0,
      sigma_t: isMedia ? size * sigma_t : 0,
      radiance: [bits & 511, (bits >>> 9) & 511, (bits >>> 18) & 511].map((c) => c * step),
      page: pages[i],
    };
  }
  return { bytes, pages, total, min, extent, record };
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const luminance = (c) => 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];

/** From the middle of a box to its farthest corner, of three edges. */
function boxReach(edges) {
  const corners = [[1, 1], [1, -1], [-1, 1], [-1, -1]];
  return Math.max(...corners.map(([b, c]) => Math.hypot(...[0, 1, 2].map((k) => edges[0][k] + b * edges[1][k] + c * edges[2][k])))) / 2;
}

/** The matrix, column by column, that takes half of each edge to a unit vector. */
function boxFromScene([a, b, c]) {
  const rows = [cross(b, c), cross(c, a), cross(a, b)];
  const scale = 2 / dot(a, rows[0]);
  return [0, 1, 2].flatMap((k) => rows.map((row) => row[k] * scale));
}

/** A camera that turns around a place. */
class Orbit {
  constructor(min, extent) {
    this.middle = min.map((v, k) => v + extent[k] / 2);
    this.size = Math.hypot(...extent) / 2 || 1;
    this.reset();
  }
  reset() {
    this.target = [...this.middle];
    [this.yaw, this.pitch, this.distance] = [0.6, 0.35, this.size * 2.5];
  }
  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + pitch));
  }
  /** Moves by shares of the height of the view. */
  move(x, y) {
    const { right, up } = this.axes();
    const far = this.distance * 0.8;
    this.target = this.target.map((v, k) => v - (right[k] * x + up[k] * y) * far);
  }
  approach(factor) {
    this.distance = Math.max(this.size * 1e-3, Math.min(this.size * 20, this.distance * factor));
  }
  axes() {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const back = [sy * cp, sp, cy * cp];
    const right = [cy, 0, -sy];
    return { back, right, up: cross(back, right) };
  }
  /** The eye, and the matrix to clip space, column by column. */
  matrix(aspect) {
    const { back, right, up } = this.axes();
    const eye = this.target.map((v, k) => v + back[k] * this.distance);
    const far = this.distance + this.size * 3;
    const near = Math.max(this.distance - this.size * 3, far * 1e-4);
    const y = 1 / Math.tan(0.38) / Math.max(1, 1 / aspect);
    const x = y / aspect;
    const [a, b] = [-(far + near) / (far - near), (-2 * far * near) / (far - near)];
    const [tx, ty, tz] = [-dot(right, eye), -dot(up, eye), -dot(back, eye)];
    const matrix = [];
    for (let k = 0; k < 3; k++) matrix.push(x * right[k], y * up[k], a * back[k], -back[k]);
    matrix.push(x * tx, y * ty, a * tz + b, -tz);
    return { eye, right, up, matrix };
  }
}

function compiled(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

function showView() {
  const view = data.view;
  const notes = data.notes.map((text) => Object.assign(document.createElement("li"), { textContent: text }));
  byId("notes").replaceChildren(...notes);
  byId("view").hidden = false;
  const problem = (text) => {
    byId("view-problem").textContent = text;
    byId("view-problem").hidden = false;
    for (const id of ["stage", "controls", "view-help"]) byId(id).hidden = true;
    byId("controls").style.display = "none";
    if (isProbed) leave({ webgl: false, problem: text });
  };
  if (!view) return problem("There is no point in this file.");
  const points = loadPoints(view);
  const levels = view.groups.filter((g) => g.kind === "node").length;
  const surfels = view.groups.find((g) => g.kind === "surfel");
  const media = view.groups.filter((g) => g.kind === "lvoxel");
  const last = levels - 1 + (surfels && levels > 0 ? 1 : 0);

  const canvas = byId("canvas");
  const gl = canvas.getContext("webgl2", { antialias: false });
  showHistograms();
  if (!gl) return problem("This browser gives no WebGL2, which the view needs. All else is here.");
  const program = compiled(gl);
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(program, name));
    return places.get(name);
  };
  const buffers = [points.bytes, points.pages].map((array) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    return buffer;
  });
  for (let i = 0; i < 5; i++) {
    gl.enableVertexAttribArray(i);
    gl.vertexAttribDivisor(i, 1);
  }
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);

  // Of an interactive page colours are chosen by eye; middle grey is the mean of the file.
  const mean = (view.mean[0] + view.mean[1] + view.mean[2]) / 3;
  const exposureAt0 = mean > 0 ? 0.18 / mean : 1;
  const exposure = () => exposureAt0 * 2 ** Number(byId("exposure").value);
  const ranges = (() => {
    const found = [Infinity, -Infinity, Infinity, -Infinity];
    for (const group of view.groups) {
      for (let i = group.first; i < group.first + group.count; i++) {
        const { radius, sigma_t } = points.record(group, i);
        if (radius > 0) found.splice(0, 2, Math.min(found[0], Math.log(radius)), Math.max(found[1], Math.log(radius)));
        if (sigma_t > 0) found.splice(2, 2, Math.min(found[2], Math.log(sigma_t)), Math.max(found[3], Math.log(sigma_t)));
      }
    }
    return found.map((v) => (Number.isFinite(v) ? v : 0));
  })();
  const orbit = new Orbit(points.min, points.extent);
  const level = byId("level");
  const media_only = last < 0 && !surfels;
  level.max = Math.max(0, last);
  level.value = last;

  /** The groups that are drawn, and whether only their marked points are. */
  function shownGroups() {
    const chosen = Number(level.value);
    const found = [];
    if (byId("surfaces").checked) {
      if (surfels && (levels === 0 || chosen === levels)) found.push([surfels, false]);
      else {
        for (const group of view.groups) {
          if (group.kind === "node" && group.level <= chosen) found.push([group, group.level < chosen]);
        }
      }
    }
    if (byId("media").checked) for (const group of media) found.push([group, false]);
    return found;
  }

  function eachShown(call) {
    for (const [group, isMarkedOnly] of shownGroups()) {
      for (let i = group.first; i < group.first + group.count; i++) {
        const found = points.record(group, i);
        if (!isMarkedOnly || found.isMarked) call(found, group);
      }
    }
  }

  function render(isPick) {
    const [width, height] = sized(canvas);
    const camera = orbit.matrix(width / height);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(at("u_clip_from_scene"), false, camera.matrix);
    gl.uniform3fv(at("u_min"), points.min);
    gl.uniform3fv(at("u_extent"), points.extent);
    gl.uniform3fv(at("u_eye"), camera.eye);
    gl.uniform3fv(at("u_right"), camera.right);
    gl.uniform3fv(at("u_up"), camera.up);
    gl.uniform2f(at("u_unit"), view.units.radius, view.units.sigma_t);
    gl.uniform1f(at("u_light"), view.units.radiance * exposure());
    gl.uniform4fv(at("u_ranges"), ranges);
    gl.uniform1i(at("u_mode"), MODES.indexOf(byId("colour").value));
    gl.uniform1i(at("u_backs"), byId("backs").checked ? 1 : 0);
    gl.uniform1i(at("u_pick"), isPick ? 1 : 0);
    // In the colours of their light boxes are as bright as the file says.
    gl.uniform1i(at("u_faces"), byId("colour").value === "radiance" ? 0 : 1);
    const size = 2 ** Number(byId("size").value);
    for (const [group, isMarkedOnly] of shownGroups()) {
      if (group.count === 0) continue;
      gl.uniform1f(at("u_grow"), group.grow * size);
      gl.uniform1f(at("u_ball"), group.ball ?? 0);
      if (group.kind === "lvoxel") {
        gl.uniform1f(at("u_reach"), boxReach(group.edges));
        gl.uniformMatrix3fv(at("u_box_from_scene"), false, boxFromScene(group.edges));
      }
      gl.uniform1i(at("u_volume"), group.volume ?? 0);
      gl.uniform1i(at("u_marked_only"), isMarkedOnly ? 1 : 0);
      gl.uniform1ui(at("u_first"), group.first);
      const start = group.first * POINT_BYTES;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[0]);
      gl.vertexAttribIPointer(0, 3, gl.UNSIGNED_SHORT, POINT_BYTES, start);
      gl.vertexAttribIPointer(1, 2, gl.UNSIGNED_BYTE, POINT_BYTES, start + 6);
      gl.vertexAttribIPointer(2, 1, gl.UNSIGNED_SHORT, POINT_BYTES, start + 8);
      gl.vertexAttribIPointer(3, 2, gl.UNSIGNED_SHORT, POINT_BYTES, start + 10);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[1]);
      gl.vertexAttribIPointer(4, 1, gl.UNSIGNED_INT, 4, group.first * 4);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, group.count);
    }
    return [width, height];
  }

  let isAsked = false;
  function redraw() {
    if (isAsked) return;
    isAsked = true;
    requestAnimationFrame(() => {
      isAsked = false;
      render(false);
    });
  }

  function tellShown() {
    const chosen = Number(level.value);
    let n = 0;
    eachShown(() => n++);
    const what = levels === 0 ? "" : chosen === levels ? ", surfels" : `, level ${chosen}`;
    byId("drawn").textContent = `${count(n)} points${what}`;
    byId("level-value").textContent = levels === 0 ? "" : chosen === levels ? "surfels" : String(chosen);
    return n;
  }

  function pick(x, y) {
    const [width, height] = render(true);
    const pixel = new Uint8Array(4);
    const ratio = width / canvas.clientWidth;
    gl.readPixels(Math.floor(x * ratio), height - 1 - Math.floor(y * ratio), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    render(false);
    return pixel[3] === 0 ? -1 : pixel[0] + pixel[1] * 256 + pixel[2] * 65536 - 1;
  }

  function tellRecord(id) {
    const group = view.groups.find((g) => id >= g.first && id < g.first + g.count);
    if (!group) return byId("record").replaceChildren();
    const found = points.record(group, id);
    const triple = (v) => v.map((c) => number(c, 5)).join(", ");
    const isMedia = group.kind === "lvoxel";
    const pairs = [[group.kind, isMedia ? `of volume ${group.name || group.volume}, level ${found.level}`
      : group.kind === "node" ? `at level ${group.level}` : ""],
      ["page", `${data.map.name} ${found.page} of ${isMedia ? "lvoxels" : "surfels"}`],
      ["place", `${triple(found.place.map((v, k) => v + view.world_from_scene[k]))} in world space`]];
    if (found.normal) pairs.push(["normal", triple(found.normal)]);
    if (!isMedia) pairs.push(["radius", number(found.radius, 4)]);
    else pairs.push(["edges", group.edges.map((e) => number(Math.hypot(...e) * 2 ** found.level, 4)).join(", ")]);
    if (isMedia) pairs.push(["sigma_t", number(found.sigma_t, 4)]);
    pairs.push([isMedia ? "source" : "radiance", triple(found.radiance.map((c) => Number(c.toPrecision(4))))]);
    showPairs(byId("record"), pairs);
  }

  function showHistograms() {
    if (!isFinite(points.total) || points.total === 0) return;
    byId("histograms").hidden = false;
    byId("charts").replaceChildren();
    const surfaces = { radius: [], light: [], level: [] };
    const inMedia = { sigma_t: [], light: [], level: [] };
    const chosen = byId("level").max === "" || !byId("level").value ? last : Number(byId("level").value);
    for (const group of view.groups) {
      const isMedia = group.kind === "lvoxel";
      const isShown = isMedia || (group.kind === "surfel" ? levels === 0 || chosen === levels : group.level <= chosen && chosen < levels);
      if (!isShown) continue;
      for (let i = group.first; i < group.first + group.count; i++) {
        const found = points.record(group, i);
        if (group.kind === "node" && group.level < chosen && !found.isMarked) continue;
        const to = isMedia ? inMedia : surfaces;
        (isMedia ? to.sigma_t : to.radius).push(isMedia ? found.sigma_t : found.radius);
        to.light.push(luminance(found.radiance));
        to.level.push(found.level);
      }
    }
    if (surfaces.radius.length > 0) {
      histogram("Radius", "", surfaces.radius, surfaces.level);
      histogram("Luminance of surfaces", "", surfaces.light, surfaces.level);
    }
    if (inMedia.sigma_t.length > 0) {
      histogram("sigma_t", " per unit of length", inMedia.sigma_t, inMedia.level);
      histogram("Luminance of media", "", inMedia.light, inMedia.level);
    }
  }

  function listen() {
    const pointers = new Map();
    let travelled = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      travelled = pointers.size > 1 ? Infinity : 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = [event.offsetX, event.offsetY];
      const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      travelled += Math.hypot(dx, dy);
      if (pointers.size === 2) {
        const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
        const apart = (p) => Math.max(1, Math.hypot(p[0] - other[0], p[1] - other[1]));
        orbit.approach(apart(before) / apart(now));
        orbit.move(dx / 2 / canvas.clientHeight, -dy / 2 / canvas.clientHeight);
      } else if (event.shiftKey || event.buttons & 6) {
        orbit.move(dx / canvas.clientHeight, -dy / canvas.clientHeight);
      } else orbit.turn(-dx * 0.008, dy * 0.008);
      pointers.set(event.pointerId, now);
      redraw();
    });
    const end = (event) => {
      if (pointers.delete(event.pointerId) && event.type === "pointerup" && travelled < 4) {
        tellRecord(pick(event.offsetX, event.offsetY));
      }
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      orbit.approach(2 ** (Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 120) * 0.002));
      redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      const change = { "[": -1, "]": 1 }[event.key];
      if (step && event.shiftKey) orbit.move(step[0] * 0.05, step[1] * 0.05);
      else if (step) orbit.turn(step[0] * 0.1, step[1] * 0.1);
      else if (event.key === "+" || event.key === "=") orbit.approach(0.85);
      else if (event.key === "-") orbit.approach(1 / 0.85);
      else if (event.key === "0") orbit.reset();
      else if (change) {
        level.value = Number(level.value) + change;
        level.dispatchEvent(new Event("change"));
      } else if (event.key === "Enter") tellRecord(pick(canvas.clientWidth / 2, canvas.clientHeight / 2));
      else return;
      event.preventDefault();
      redraw();
    });
    const tellSliders = () => {
      byId("exposure-value").textContent = stopsText(Number(byId("exposure").value));
      byId("size-value").textContent = "× " + number(2 ** Number(byId("size").value), 3);
      tellShown();
      redraw();
    };
    for (const input of byId("controls").querySelectorAll("input, select")) input.addEventListener("input", tellSliders);
    level.addEventListener("change", () => {
      tellSliders();
      showHistograms();
    });
    byId("controls").addEventListener("submit", (event) => event.preventDefault());
    byId("reset").addEventListener("click", () => {
      for (const id of ["exposure", "size"]) byId(id).value = 0;
      orbit.reset();
      tellSliders();
    });
    tellSliders();
  }

  byId("level-label").hidden = levels === 0;
  if (levels === 0) byId("level-label").style.display = "none";
  for (const [id, isThere] of [["surfaces", !media_only], ["media", media.length > 0]]) {
    byId(id).parentElement.style.display = isThere ? "" : "none";
  }
  for (const option of byId("colour").options) {
    const isOfMedia = ["volume", "sigma_t"].includes(option.value);
    option.hidden = option.disabled = (isOfMedia && media.length === 0) || (media_only && option.value === "normal");
  }
  canvas.addEventListener("webglcontextlost", () => problem("The graphics processor has gone away: load the page again."));
  listen();
  whenLooksChange(() => {
    redraw();
    showHistograms();
  });

  if (!isProbed) return;
  const [width, height] = render(false);
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  const sums = [0, 0, 0];
  let covered = 0;
  for (let i = 0; i < pixels.length; i += 4) {
    if (pixels[i + 3] === 0) continue;
    covered++;
    for (let c = 0; c < 3; c++) sums[c] += (pixels[i + c] / 255) ** 2.2 / exposure();
  }
  let area = 0;
  const weighed = [0, 0, 0];
  eachShown(({ radius, radiance }, { kind }) => {
    if (kind === "lvoxel" && !media_only) return;
    area += radius ** 2;
    for (let c = 0; c < 3; c++) weighed[c] += radiance[c] * radius ** 2;
  });
  const id = pick(canvas.clientWidth / 2, canvas.clientHeight / 2);
  tellRecord(id);
  leave({ webgl: true, error: gl.getError(), drawn: tellShown(), total: points.total, levels, share: covered / (width * height), size: [width, height],
    mean_of_pixels: sums.map((s) => s / Math.max(1, covered)), mean_of_points: weighed.map((s) => s / area),
    mean_of_file: view.mean, picked: byId("record").textContent });
}

showView();
