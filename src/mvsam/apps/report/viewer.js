// Draws the labelled points and the cameras in plain WebGL, and listens to the page's buttons.
// The numbers stand as JSON in the element "cloud", made by cloud_data.py.
"use strict";

const VERTEX_SHADER = `
attribute vec3 position;
attribute vec4 color;
uniform mat4 clipFromWorld;
uniform vec3 low, extent;
uniform float pointSize, smallestSize;
varying vec3 shown;
void main() {
  bool isHidden = color.a == 0.0;
  vec4 place = clipFromWorld * vec4(low + extent * position, 1.0);
  gl_Position = isHidden ? vec4(2.0, 2.0, 2.0, 1.0) : place;
  gl_PointSize = clamp(pointSize / place.w, smallestSize, 64.0);
  shown = color.rgb;
}`;
const FRAGMENT_SHADER = `
precision mediump float;
uniform bool isPoint;
varying vec3 shown;
void main() {
  if (isPoint && length(gl_PointCoord - 0.5) > 0.5) discard;
  gl_FragColor = vec4(shown, 1.0);
}`;
const UNLABELLED = 255; // has no button: hidden where a class is shown alone
const CAMERA_COLOR = [0.95, 0.45, 0.1];

const decoded = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

// What the user chose to see of the points.
class Paint {
  constructor(scene) {
    this.photo = decoded(scene.colors);
    this.labels = decoded(scene.labels);
    this.confidence = decoded(scene.confidence);
    this.palette = scene.palette;
    this.unsureToSure = scene.unsureToSure;
    this.coloring = "photo";
    this.hidden = new Set(); // labels
  }

  // Four bytes a point, the last 0 where it is hidden.
  colors() {
    const colors = new Uint8Array(4 * this.labels.length);
    const colorOf = {
      photo: (point) => this.photo.subarray(3 * point, 3 * point + 3),
      classes: (point) => this.palette[this.labels[point]],
      confidence: (point) => this.unsureToSure[this.confidence[point]],
    }[this.coloring];
    this.labels.forEach((label, point) => {
      colors.set(colorOf(point), 4 * point);
      colors[4 * point + 3] = this.hidden.has(label) ? 0 : 255;
    });
    return colors;
  }
}

// Sets up the shaders; returns what finds their uniforms.
function useShaders(gl) {
  const program = gl.createProgram();
  const shaders = [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]];
  for (const [kind, text] of shaders) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "position");
  gl.bindAttribLocation(program, 1, "color");
  gl.linkProgram(program);
  gl.useProgram(program);
  return (name) => gl.getUniformLocation(program, name);
}

class Drawing {
  constructor(gl, scene, orbit, paint) {
    Object.assign(this, { gl, scene, orbit, paint, showsCameras: true, isWaiting: false });
    this.uniform = useShaders(gl);
    const frusta = decoded(scene.frusta);
    this.numLineEnds = frusta.length / 12;
    this.buffers = {};
    this.fill("positions", decoded(scene.positions));
    this.fill("colors", paint.colors());
    this.fill("frusta", frusta);
    gl.enableVertexAttribArray(0);
    gl.enable(gl.DEPTH_TEST);
  }

  fill(name, bytes) {
    this.buffers[name] ??= this.gl.createBuffer();
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffers[name]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, bytes, this.gl.STATIC_DRAW);
  }

  // Soon, and once however often it is asked for until then.
  redraw() {
    if (!this.isWaiting) requestAnimationFrame(() => this.draw());
    this.isWaiting = true;
  }

  repaint() {
    this.fill("colors", this.paint.colors());
    this.redraw();
  }

  draw() {
    const { gl, uniform, scene, orbit } = this, { canvas } = gl;
    this.isWaiting = false;
    const width = Math.round(canvas.clientWidth * devicePixelRatio);
    const height = Math.round(canvas.clientHeight * devicePixelRatio);
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); // to transparent: the page shows through
    gl.uniformMatrix4fv(uniform("clipFromWorld"), false, orbit.clipFromWorld(width / height));
    // Somewhat larger than a voxel, so that surfaces close up when seen from near.
    gl.uniform1f(uniform("pointSize"), (1.5 * scene.voxelSize * height) / (2 * orbit.halfView));
    gl.uniform1f(uniform("smallestSize"), 1.5 * devicePixelRatio);
    this.drawPoints();
    if (this.showsCameras) this.drawCameras();
  }

  drawPoints() {
    const { gl, uniform, scene } = this;
    gl.uniform1i(uniform("isPoint"), 1);
    gl.uniform3fv(uniform("low"), scene.low);
    gl.uniform3fv(uniform("extent"), scene.extent);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.positions);
    gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.colors);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    gl.drawArrays(gl.POINTS, 0, this.paint.labels.length);
  }

  drawCameras() {
    const { gl, uniform } = this;
    gl.uniform1i(uniform("isPoint"), 0);
    gl.uniform3f(uniform("low"), 0, 0, 0);
    gl.uniform3f(uniform("extent"), 1, 1, 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.frusta);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.disableVertexAttribArray(1);
    gl.vertexAttrib4f(1, ...CAMERA_COLOR, 1);
    gl.drawArrays(gl.LINES, 0, this.numLineEnds);
  }
}

const press = (button, isOn) => button.setAttribute("aria-pressed", isOn);
const onClick = (id, action) => document.getElementById(id)?.addEventListener("click", action);

function followColorings(drawing) {
  const buttons = document.querySelectorAll("[data-coloring]");
  for (const chosen of buttons) {
    chosen.addEventListener("click", () => {
      drawing.paint.coloring = chosen.dataset.coloring;
      buttons.forEach((button) => press(button, button === chosen));
      document.getElementById("ramp").hidden = chosen.dataset.coloring !== "confidence";
      drawing.repaint();
    });
  }
}

function followClasses(drawing) {
  const buttons = [...document.querySelectorAll("[data-label]")];
  const labels = [...buttons.map((button) => Number(button.dataset.label)), UNLABELLED];
  const hide = (isHidden) => {
    const hidden = new Set(labels.filter(isHidden));
    drawing.paint.hidden = hidden;
    buttons.forEach((button, place) => press(button, !hidden.has(labels[place])));
    drawing.repaint();
  };
  buttons.forEach((button, place) => {
    const own = labels[place];
    const toggled = (label) => drawing.paint.hidden.has(label) !== (label === own);
    const alone = (label) => label !== own;
    button.addEventListener("click", (event) => hide(event.shiftKey ? alone : toggled));
    button.addEventListener("dblclick", () => hide(alone));
  });
  onClick("all-classes", () => hide(() => false));
}

function followView(drawing) {
  const cameras = document.getElementById("cameras");
  onClick("cameras", () => {
    drawing.showsCameras = !drawing.showsCameras;
    press(cameras, drawing.showsCameras);
    drawing.redraw();
  });
  onClick("first-view", () => {
    drawing.orbit.reset();
    drawing.redraw();
  });
}

function sayThereIsNoWebGL() {
  document.querySelectorAll("#viewer, #hiding").forEach((part) => (part.hidden = true));
  document.getElementById("no-webgl").hidden = false;
  document.querySelectorAll("[data-label]").forEach((button) => (button.disabled = true));
}

function start() {
  const canvas = document.getElementById("view");
  const gl = canvas.getContext("webgl");
  if (!gl) return sayThereIsNoWebGL();
  const scene = JSON.parse(document.getElementById("cloud").textContent);
  const orbit = new Orbit(scene.firstView);
  const drawing = new Drawing(gl, scene, orbit, new Paint(scene));
  const redraw = () => drawing.redraw();
  followPointers(canvas, orbit, redraw);
  followKeys(canvas, orbit, redraw);
  followColorings(drawing);
  followClasses(drawing);
  followView(drawing);
  new ResizeObserver(redraw).observe(canvas);
}

start();
