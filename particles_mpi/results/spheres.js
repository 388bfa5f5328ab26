"use strict";
// Draws spheres of true radii, lines and walls by WebGL 2. A sphere is a square that faces the viewer, of which each pixel is
// lit and given its depth as if it were a sphere: exact where spheres touch or cut one another, and cheap.

const OPENING = 0.3;  // radians: half of the angle of view

const SPHERE_VERTEX = `#version 300 es
layout(location = 0) in vec2 corner;
layout(location = 1) in vec3 center;
layout(location = 2) in float radius;
layout(location = 3) in float value;  // 0 to 1, of the colours
layout(location = 4) in float rim;  // 1: fixed
uniform mat4 view, projection;
uniform float grow, pixel, smallest;  // pixel: its size at distance 1, or everywhere if flat; smallest radius in pixels
uniform bool flat_view;
out vec2 at;
flat out float shade, edge, size_in_pixels, size;
flat out vec3 middle, right, up, eye;
void main() {
  middle = (view * vec4(center, 1.0)).xyz;
  float distance = flat_view ? 1.0 : length(middle);
  float unit = pixel * distance;
  size = max(radius * grow, smallest * unit);
  eye = flat_view ? vec3(0.0, 0.0, 1.0) : -middle / distance;
  float inside = flat_view ? 0.0 : min(size / distance, 0.95);
  float outline = size / sqrt(1.0 - inside * inside);  // perspective shows a sphere larger than its cross-section
  right = normalize(cross(abs(eye.y) < 0.99 ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0), eye));
  up = cross(eye, right);
  vec2 reach = corner * (1.0 + unit / size);  // a pixel more, for a smooth edge
  at = reach;
  shade = value; edge = rim; size_in_pixels = size / unit;
  gl_Position = projection * vec4(middle + outline * (reach.x * right + reach.y * up), 1.0);
}`;

const SPHERE_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
flat in float shade, edge, size_in_pixels, size;
flat in vec3 middle, right, up, eye;
uniform mat4 projection;
uniform sampler2D colors;
uniform vec3 ground;
uniform vec2 haze;  // distances from which on, and at which, half of the colour is the ground's
out vec4 color;
void main() {
  float out2 = dot(at, at), blur = 1.0 / size_in_pixels;
  float cover = clamp((1.0 - sqrt(out2)) / blur + 0.5, 0.0, 1.0);
  if (cover <= 0.0) discard;
  float z = sqrt(max(0.0, 1.0 - out2));
  vec3 normal = at.x * right + at.y * up + z * eye;
  vec4 place = projection * vec4(middle + size * normal, 1.0);
  gl_FragDepth = clamp(0.5 * place.z / place.w + 0.5, 0.0, 1.0);
  vec3 base = texture(colors, vec2((clamp(shade, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5)).rgb;
  float strength = clamp(size_in_pixels / 5.0, 0.25, 1.0);  // dots of a few pixels keep the colour of the bar
  vec3 lamp = normalize(vec3(-0.45, 0.6, 0.75));
  float light = 0.5 + 0.6 * max(dot(normal, lamp), 0.0);
  color.rgb = base * mix(1.0, light * pow(max(z, 0.02), 0.25), strength);
  color.rgb += (1.0 - color.rgb) * 0.35 * strength * pow(max(dot(normal, normalize(lamp + eye)), 0.0), 40.0);
  float ring = max(0.07, 1.6 * blur);
  if (edge > 0.5 && sqrt(out2) > 1.0 - ring) color.rgb = 1.0 - ground;
  color.rgb = mix(color.rgb, ground, 0.5 * clamp((length(middle) - haze.x) / (haze.y - haze.x), 0.0, 1.0));
  color.a = cover;
}`;

const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec4 paint;
uniform mat4 view, projection;
out vec4 ink;
void main() { ink = paint; gl_Position = projection * view * vec4(place, 1.0); }`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec4 ink;
out vec4 color;
void main() { color = ink; }`;

class Spheres {
  constructor(canvas) {
    const gl = this.gl = canvas.getContext("webgl2", {alpha: false, antialias: true, preserveDrawingBuffer: true});
    if (!gl) throw new Error("this browser shows no WebGL 2, which draws the spheres");
    this.canvas = canvas;
    this.balls = this.program(SPHERE_VERTEX, SPHERE_FRAGMENT);
    this.ink = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.count = 0;
    this.around = gl.createVertexArray();
    gl.bindVertexArray(this.around);
    this.attribute(0, 2, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), 0);
    this.buffers = [3, 1, 1, 1].map((width, k) => this.attribute(k + 1, width, new Float32Array(0), 1));
    this.drawn = gl.createVertexArray();
    gl.bindVertexArray(this.drawn);
    this.lineBuffer = this.attribute(0, 3, new Float32Array(0), 0);
    this.paintBuffer = this.attribute(1, 4, new Float32Array(0), 0);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  }

  program(...sources) {
    const gl = this.gl, made = gl.createProgram();
    sources.forEach((source, k) => {
      const shader = gl.createShader(k ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    });
    gl.linkProgram(made);
    return {made, at: new Proxy({}, {get: (_, name) => gl.getUniformLocation(made, name)})};
  }

  attribute(place, width, values, each) {  // each: 1 for one value a sphere, 0 for one a corner
    const gl = this.gl, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    gl.vertexAttribDivisor(place, each);
    return buffer;
  }

  fill(buffer, values) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, buffer);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.DYNAMIC_DRAW);
  }

  setColors(bytes) {
    const gl = this.gl;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, bytes);
  }

  setSpheres(centers, radii, values, rims) {  // Float32Arrays: (3n), (n), (n) from 0 to 1, (n)
    this.count = radii.length;
    [centers, radii, values, rims].forEach((numbers, k) => this.fill(this.buffers[k], numbers));
  }

  // lines, faces: [[place, place, ...], [r, g, b, a]]: a line through the places, or a convex polygon
  draw(camera, {lines, faces, ground, grow, smallest}) {
    const gl = this.gl, width = this.canvas.width, height = this.canvas.height;
    gl.viewport(0, 0, width, height);
    gl.clearColor(...ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const {view, projection} = camera.matrices(width / height);
    gl.useProgram(this.balls.made);
    const at = this.balls.at;
    gl.uniformMatrix4fv(at.view, false, view);
    gl.uniformMatrix4fv(at.projection, false, projection);
    gl.uniform1f(at.grow, grow);
    gl.uniform1f(at.smallest, smallest);
    gl.uniform1f(at.pixel, camera.pixel(height));
    gl.uniform1i(at.flat_view, camera.flat ? 1 : 0);
    gl.uniform3f(at.ground, ...ground);
    gl.uniform2f(at.haze, ...(camera.flat ? [1e30, 2e30] : [camera.distance - 0.5 * camera.size, camera.distance + camera.size]));
    gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.bindVertexArray(this.around);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.useProgram(this.ink.made);
    gl.uniformMatrix4fv(this.ink.at.view, false, view);
    gl.uniformMatrix4fv(this.ink.at.projection, false, projection);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.drawn);
    const pieces = [], places = [], paints = [];
    for (const [shapes, kind] of [[lines, gl.LINE_STRIP], [faces, gl.TRIANGLE_FAN]])
      for (const [points, paint] of shapes) {
        pieces.push([kind, places.length / 3, points.length]);
        points.forEach((point, k) => {
          places.push(...point);
          paints.push(...(Array.isArray(paint[0]) ? paint[k] : paint));
        });
      }
    this.fill(this.lineBuffer, new Float32Array(places));
    this.fill(this.paintBuffer, new Float32Array(paints));
    for (const [kind, first, count] of pieces) {
      gl.depthMask(kind !== gl.TRIANGLE_FAN);
      gl.drawArrays(kind, first, count);
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }
}

// Where the viewer stands: turned around a target, at a distance; `flat`: from above, without perspective.
class Camera {
  constructor(size, flat) {
    this.size = size;  // diagonal of all that there is
    this.flat = flat;
  }

  // Sees all of a box of these lengths around the origin; aspect: width of the picture over its height.
  reset([wide, high], aspect) {
    this.chosen = false;  // by the user: then another size of the window leaves the view as it is
    this.target = [0, 0, 0];
    this.distance = this.flat ? 0.6 * Math.max(high, wide / aspect) : 1.72 * this.size * Math.max(1, 1 / aspect);
    this.azimuth = -Math.PI / 3;
    this.elevation = Math.PI / 9;
  }

  axes() {  // right, up, towards the viewer
    if (this.flat) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
  }

  pixel(height) {
    return (this.flat ? 2 * this.distance : 2 * Math.tan(OPENING)) / height;
  }

  matrices(aspect) {
    const axes = this.axes(), view = new Float32Array(16), projection = new Float32Array(16);
    axes.forEach((axis, row) => {
      for (let k = 0; k < 3; k++) view[4 * k + row] = axis[k];
      view[12 + row] = -(axis[0] * this.target[0] + axis[1] * this.target[1] + axis[2] * this.target[2]);
    });
    view[14] -= this.flat ? 2 * this.size : this.distance;
    view[15] = 1;
    const far = this.flat ? 4 * this.size : this.distance + 3 * this.size;
    const near = this.flat ? 0 : Math.max(far / 5000, this.distance - 1.5 * this.size), deep = far - near;
    const half = this.flat ? this.distance : Math.tan(OPENING);  // of the height of the picture, there or at distance 1
    projection[0] = 1 / (half * aspect);
    projection[5] = 1 / half;
    if (this.flat) [projection[10], projection[14], projection[15]] = [-2 / deep, -(far + near) / deep, 1];
    else [projection[10], projection[11], projection[14]] = [-(far + near) / deep, -1, -2 * far * near / deep];
    return {view, projection};
  }

  turn(dx, dy) {
    this.chosen = true;
    this.azimuth -= dx;
    this.elevation = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.elevation + dy));
  }

  move(dx, dy, height) {  // by pixels
    this.chosen = true;
    const scale = this.pixel(height) * (this.flat ? 1 : this.distance), [right, up] = this.axes();
    for (let k = 0; k < 3; k++) this.target[k] -= scale * (dx * right[k] - dy * up[k]);
  }

  zoom(factor) {
    this.chosen = true;
    this.distance = Math.max(1e-5 * this.size, Math.min(20 * this.size, this.distance * factor));
  }
}
