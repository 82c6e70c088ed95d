// Colours of the layers: a byte a pixel comes in, a canvas is painted.

const BROWN = [51, 35, 29];
const REACH = [[13, 8, 135], [126, 3, 168], [204, 71, 120], [248, 149, 64], [240, 249, 33]];
const FIRST_REFUSED = 249; // pixels of the cost from here on: the limit that refuses the vehicle

function table(colour) {
  const found = new Uint32Array(256);
  const bytes = new Uint8ClampedArray(found.buffer);
  for (let value = 0; value < 256; value++) bytes.set(colour(value), 4 * value);
  return found;
}

const TABLES = {
  relief: table((value) => (value === 0 ? [250, 250, 250, 255] : [105 + 0.6 * value, 105 + 0.6 * value, 105 + 0.6 * value, 255])),
  slope: table((value) => [0, 114, 178, 0.9 * value]),
  cost: table((value) => (value === 255 ? [...BROWN, 230] : [156, 107, 30, 0.9 * value])),
  region: table((value) => [0, 114, 178, 0.3 * value]),
};

// The colours of ground where the vehicle stands in no heading, by the limit that refuses it.
export function colourRefused(colours) {
  const refused = table((value) => [...(colours[value - FIRST_REFUSED] ?? BROWN), 200]);
  TABLES.cost.set(refused.subarray(FIRST_REFUSED, 255), FIRST_REFUSED);
}

// As many colours as there are bands of what can be reached, the nearest first; CSS colours are returned.
export function colourBands(count) {
  const colours = Array.from({ length: count }, (_, at) => {
    const place = (REACH.length - 1) * (count > 1 ? at / (count - 1) : 0);
    const low = Math.min(Math.floor(place), REACH.length - 2);
    return REACH[low].map((from, channel) => Math.round(from + (place - low) * (REACH[low + 1][channel] - from)));
  });
  TABLES.reach = table((value) => (colours[value - 1] ? [...colours[value - 1], 170] : [0, 0, 0, 0]));
  return colours.map((colour) => `rgb(${colour})`);
}

export function paint(canvas, { rows, cols, pixels }) {
  const colours = TABLES[canvas.id];
  if (canvas.width !== cols || canvas.height !== rows) {
    canvas.width = cols;
    canvas.height = rows;
  }
  const context = canvas.getContext("2d");
  const image = context.createImageData(cols, rows);
  const out = new Uint32Array(image.data.buffer);
  for (let at = 0; at < out.length; at++) out[at] = colours[pixels[at]];
  if (canvas.id === "relief") {
    // what is unknown is striped
    const [grey] = new Uint32Array(new Uint8ClampedArray([140, 140, 140, 255]).buffer);
    for (let at = 0; at < out.length; at++)
      if (pixels[at] === 0 && ((at % cols) + Math.floor(at / cols)) % 9 < 2) out[at] = grey;
  }
  context.putImageData(image, 0, 0);
}
