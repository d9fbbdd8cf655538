// Counts less rest as colours: one diverging scale of the signed square root, as colours.py describes it.

let stops = null;

// The colours from rest to the ends, for each theme; a scene brings them.
export function useStops(told) {
  stops = told;
}

export const share = (value, limit) =>
  Math.sign(value) * Math.sqrt(Math.min(Math.abs(value), limit) / limit);

export function colourOf(value, limit, theme) {
  const part = share(value, limit);
  const side = stops[theme][part < 0 ? "below" : "above"];
  const place = Math.abs(part) * (side.length - 1);
  const first = Math.min(Math.floor(place), side.length - 2);
  return side[first].map((from, i) => Math.round(from + (side[first + 1][i] - from) * (place - first)));
}

export const css = ([red, green, blue]) => `rgb(${red}, ${green}, ${blue})`;

// Black or white, whichever can be read on a colour (relative luminance, WCAG 2).
export function inkOn(colour) {
  const [r, g, b] = colour.map((part) => {
    const x = part / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.18 ? "#000" : "#fff";
}

export function drawLegend(place, limit, theme) {
  const ticks = [-limit, -limit / 4, -limit / 20, 0, limit / 20, limit / 4, limit];
  place.innerHTML = `<div class="scale"><div class="words"><span>◀ pressed</span>
    <span>counts less rest</span><span>bulged ▶</span></div>
    <canvas width="401" height="1"></canvas><div class="ticks"></div></div>`;
  const canvas = place.querySelector("canvas");
  const paint = canvas.getContext("2d");
  for (let x = 0; x < canvas.width; x++) {
    const part = (2 * x) / (canvas.width - 1) - 1;
    paint.fillStyle = css(colourOf(Math.sign(part) * part * part * limit, limit, theme));
    paint.fillRect(x, 0, 1, 1);
  }
  place.querySelector(".ticks").append(...ticks.map((value) => {
    const label = document.createElement("span");
    const end = Math.abs(value) === limit ? (value < 0 ? "≤ " : "≥ ") : "";
    label.textContent = end + signed(value);
    if (end) label.style[value < 0 ? "left" : "right"] = 0;
    else label.style.left = `${50 * (share(value, limit) + 1)}%`;
    label.classList.toggle("end", end !== "");
    return label;
  }));
}

export function signed(value, digits = 0) {
  const text = Math.abs(value).toFixed(digits);
  if (Number(text) === 0) return text;
  return (value < 0 ? "−" : "+") + text;
}
