// Definitions of the panel's choices and sliders, which are created where page.html names them.

export const $ = (id) => document.getElementById(id);
export const number = (value, digits = 3) => Number(value.toPrecision(digits)).toString();

const signed = (value) => `${value > 0 ? "+" : ""}${number(value)}`;

// By name of the state: legend, columns (0 is a single row), options.
export const CHOICES = {
  shape: ["Surface", 0, { plane: "Plane", sphere: "Sphere", cylinder: "Cylinder" }],
  light: ["Light", 0, { point: "Point", studio: "Studio", window: "Window", dusk: "Dusk" }],
  map: ["Show", 3, { lit: "Lit", diffuse: "Diffuse", specular: "Specular", roughness: "Roughness",
    height: "Height", normal: "Normal" }],
  left: ["Left of the wipe", 0, { none: "Nothing", photo: "Photo", second: "Other" }],
};

// By name of the state: label, least, most, step, formatting of a value.
const SLIDERS = {
  exposure: ["Exposure", -4, 4, 0.25, (value) => `${signed(value)} stops`],
  lift: ["Light's height", 0.2, 3, 0.1, (value) => number(value, 2)],
  share: ["Blend", 0, 1, 0.1, (value) => number(value, 2)],
};

// An element with its properties and content.
export const make = (kind, properties, ...inside) => {
  const one = Object.assign(document.createElement(kind), properties);
  one.append(...inside);
  return one;
};

export function makeControls() {
  for (const [name, [legend, columns, options]] of Object.entries(CHOICES)) {
    const cells = Object.entries(options).map(([value, text]) => make("label", {},
      make("input", { type: "radio", name, value }), make("span", { textContent: text })));
    const row = make("div", {}, ...cells);
    if (columns) row.classList.add("three");
    $(`${name}-choice`).prepend(make("legend", { textContent: legend }), row);
  }
  for (const [name, [text, min, max, step]] of Object.entries(SLIDERS)) {
    const input = make("input", { id: name, type: "range", min, max, step });
    const output = make("output", { id: `${name}-value` });
    output.htmlFor = name;
    $(`${name}-row`).append(
      make("label", { id: `${name}-label`, htmlFor: name, textContent: text }), output, input,
    );
  }
}

export function option(name, value) {
  return document.querySelector(`input[name=${name}][value=${value}]`);
}

// Whether a choice has this option.
export function offer(name, value, there) {
  option(name, value).parentElement.hidden = !there;
}

export function showSlider(name, value) {
  $(name).value = value;
  saySlider(name, value);
}

export function saySlider(name, value) {
  $(`${name}-value`).textContent = SLIDERS[name][4](value);
}
