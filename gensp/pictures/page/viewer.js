"use strict";
// Two shapes that turn together, wearing the sphere's texture through their maps. The point below
// the mouse is marked on both, through the sphere: their implied correspondence.
(() => {
  const VERTEX = `#version 300 es
    in vec3 surface, sphere, normal;
    uniform mat3 turn; uniform float zoom, morph;
    out vec3 p, n;
    void main() {
      p = sphere;
      n = turn * normalize(mix(normal, sphere, morph) + 1e-6);
      vec3 seen = turn * mix(surface, 0.85 * sphere, morph) * zoom * 0.95;
      gl_Position = vec4(seen.xy, -0.1 * seen.z, 1.0);
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 p, n;
    uniform samplerCube picture; uniform vec3 marker; uniform bool marked, picking;
    out vec4 colour;
    const vec3 KEY = vec3(-0.413, 0.597, 0.688), FILL = vec3(0.867, 0.108, 0.487);
    void main() {
      vec3 u = normalize(p), m = normalize(n);
      if (picking) { colour = vec4(0.5 + 0.5 * u, 1.0); return; }
      if (m.z < 0.0) m = -m;
      vec3 base = texture(picture, u).rgb;
      float ring = distance(u, marker);
      if (marked && ring < 0.05) base = ring < 0.035 ? vec3(1.0) : vec3(0.05);
      float light = 0.48 + 0.12 * m.y + 0.62 * max(dot(m, KEY), 0.0) + 0.22 * max(dot(m, FILL), 0.0);
      float shine = 0.06 * pow(max(dot(m, normalize(KEY + vec3(0, 0, 1))), 0.0), 40.0);
      colour = vec4(min(base * light + shine, 1.0), 1.0);
    }`;

  const data = JSON.parse(document.getElementById("shapes").textContent);
  const state = { turn: data.turn, zoom: 1, morph: 0, spin: true, marker: null };
  const panes = [];

  function numbers(text, Kind) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Kind(bytes.buffer);
  }

  function decode(shape) {
    if (shape.faces instanceof Uint32Array) return shape;
    const faces = Uint32Array.from(numbers(shape.faces, shape.wide ? Uint32Array : Uint16Array));
    const surface = Float32Array.from(numbers(shape.surface, Int16Array), (v) => v / 32767);
    const sphere = Float32Array.from(numbers(shape.sphere, Int16Array), (v) => v / 32767);
    return Object.assign(shape, { faces, surface, sphere, normal: normals(surface, faces) });
  }

  function normals(x, faces) {
    const sum = new Float32Array(x.length);
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      const e = [0, 1, 2].map((k) => x[b + k] - x[a + k]);
      const g = [0, 1, 2].map((k) => x[c + k] - x[a + k]);
      for (let k = 0; k < 3; k++) {
        const area = e[(k + 1) % 3] * g[(k + 2) % 3] - e[(k + 2) % 3] * g[(k + 1) % 3];
        sum[a + k] += area; sum[b + k] += area; sum[c + k] += area;
      }
    }
    for (let v = 0; v < sum.length; v += 3) {
      const length = Math.hypot(sum[v], sum[v + 1], sum[v + 2]) || 1;
      for (let k = 0; k < 3; k++) sum[v + k] /= length;
    }
    return sum;
  }

  function program(gl) {
    const linked = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(linked, shader);
    }
    ["surface", "sphere", "normal"].forEach((name, k) => gl.bindAttribLocation(linked, k, name));
    gl.linkProgram(linked); gl.useProgram(linked);
    return linked;
  }

  function cubeMap(gl, picture) {
    const side = picture.naturalWidth, tile = document.createElement("canvas");
    tile.width = tile.height = side;
    gl.bindTexture(gl.TEXTURE_CUBE_MAP, gl.createTexture());
    for (let face = 0; face < 6; face++) {
      tile.getContext("2d").drawImage(picture, 0, -face * side);
      gl.texImage2D(gl.TEXTURE_CUBE_MAP_POSITIVE_X + face, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, tile);
    }
    gl.generateMipmap(gl.TEXTURE_CUBE_MAP);
    gl.texParameteri(gl.TEXTURE_CUBE_MAP, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  }

  class Pane {
    constructor(canvas, select, picture) {
      Object.assign(this, { canvas, select });
      this.gl = canvas.getContext("webgl2", { antialias: true });
      if (!this.gl) throw new Error("no WebGL 2");
      this.program = program(this.gl);
      cubeMap(this.gl, picture);
      this.buffers = ["surface", "sphere", "normal"].map(() => this.gl.createBuffer());
      this.indices = this.gl.createBuffer();
      select.onchange = () => this.show(data.shapes[select.value]);
    }
    show(shape) {
      const gl = this.gl;
      this.shape = decode(shape);
      ["surface", "sphere", "normal"].forEach((name, k) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[k]);
        gl.bufferData(gl.ARRAY_BUFFER, this.shape[name], gl.STATIC_DRAW);
        gl.enableVertexAttribArray(k); gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 0, 0);
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, this.shape.faces, gl.STATIC_DRAW);
      draw();
    }
    paint(picking) {
      const gl = this.gl, at = (name) => gl.getUniformLocation(this.program, name);
      const side = Math.max(1, Math.round(this.canvas.clientWidth * devicePixelRatio));
      if (this.canvas.width !== side) this.canvas.width = this.canvas.height = side;
      gl.viewport(0, 0, side, side); gl.enable(gl.DEPTH_TEST);
      gl.clearColor(1, 1, 1, picking ? 0 : 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix3fv(at("turn"), true, state.turn.flat());
      gl.uniform1f(at("zoom"), state.zoom); gl.uniform1f(at("morph"), state.morph);
      gl.uniform1i(at("marked"), state.marker ? 1 : 0); gl.uniform1i(at("picking"), picking ? 1 : 0);
      gl.uniform3fv(at("marker"), state.marker || [0, 0, 1]);
      gl.drawElements(gl.TRIANGLES, this.shape.faces.length, gl.UNSIGNED_INT, 0);
    }
    pick(event) {
      const gl = this.gl, box = this.canvas.getBoundingClientRect(), seen = new Uint8Array(4);
      this.paint(true);
      const x = (event.clientX - box.left) / box.width * this.canvas.width;
      const y = (1 - (event.clientY - box.top) / box.height) * this.canvas.height;
      gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, seen);
      if (!seen[3]) return null;
      const u = [0, 1, 2].map((k) => seen[k] / 127.5 - 1), length = Math.hypot(...u) || 1;
      return u.map((v) => v / length);
    }
  }

  let waiting = false;
  function draw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      panes.forEach((pane) => pane.shape && pane.paint(false));
    });
  }

  function times(m, n) {
    return m.map((row) => [0, 1, 2].map((j) => row.reduce((sum, v, k) => sum + v * n[k][j], 0)));
  }

  // Rodrigues' formula: a turn by an angle about a unit axis.
  function about([x, y, z], angle) {
    const c = Math.cos(angle), s = Math.sin(angle), d = 1 - c;
    return [[c + x * x * d, x * y * d - z * s, x * z * d + y * s],
      [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
      [z * x * d - y * s, z * y * d + x * s, c + z * z * d]];
  }

  // A turntable: across about the shapes' own up axis, upward about the screen's horizontal.
  function rotate(across, upward) {
    state.turn = times(times(about([1, 0, 0], upward), state.turn), about(data.up, across));
    draw();
  }

  function listen(pane) {
    const canvas = pane.canvas;
    canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); stop(); };
    canvas.onpointermove = (event) => {
      if (event.buttons) rotate(event.movementX / 120, event.movementY / 120);
      else { state.marker = pane.pick(event); draw(); }
    };
    canvas.onpointerleave = () => { state.marker = null; draw(); };
    canvas.onwheel = (event) => {
      event.preventDefault();
      state.zoom = Math.min(8, Math.max(0.4, state.zoom * Math.exp(-event.deltaY / 700)));
      draw();
    };
  }

  function stop() { state.spin = false; document.getElementById("spin").checked = false; }

  function start() {
    const picture = document.getElementById("texture");
    document.querySelectorAll(".pane").forEach((box, k) => {
      const select = box.querySelector("select");
      const pane = new Pane(box.querySelector("canvas"), select, picture);
      data.shapes.forEach((shape, index) => select.add(new Option(shape.label, index)));
      select.value = Math.min(k, data.shapes.length - 1);
      panes.push(pane); listen(pane); pane.show(data.shapes[select.value]);
    });
    document.getElementById("morph").oninput = (event) => { state.morph = +event.target.value; draw(); };
    document.getElementById("spin").onchange = (event) => { state.spin = event.target.checked; };
    setInterval(() => state.spin && !document.hidden && rotate(0.02, 0), 40);
    window.onresize = draw;
  }

  window.addEventListener("load", () => {
    if (!data.shapes.length) return;
    try { start(); } catch (error) {
      document.getElementById("viewer-note").textContent =
        `Shapes that turn need WebGL 2, which this browser does not offer (${error.message}). The pictures show the same maps.`;
    }
  });
})();
