// An animated GIF, written frame by frame (GIF89a specification, W3C, 1990). Each frame has a palette of its own: its most frequent colours.

const COLOURS = 256, BITS = 8, LAST = 4095; // of a palette; of a pixel; the greatest code of LZW

export class Gif {
  // Size in px.
  constructor(width, height) {
    this.width = width;
    this.height = height;
    const forever = [0x21, 0xff, 11, ...letters("NETSCAPE2.0"), 3, 1, 0, 0, 0];
    this.parts = [new Uint8Array([...letters("GIF89a"), ...word(width), ...word(height), 0x70, 0, 0, ...forever])];
  }

  // One more frame: the pixels as a canvas gives them, and how long it is seen, s.
  add(rgba, seconds) {
    const { palette, pixels } = reduced(new Uint32Array(rgba.buffer));
    const timing = [0x21, 0xf9, 4, 0, ...word(Math.round(seconds * 100)), 0, 0];
    this.parts.push(new Uint8Array([...timing, 0x2c, 0, 0, 0, 0, ...word(this.width), ...word(this.height), 0x87]), palette, compressed(pixels));
  }

  blob() { return new Blob([...this.parts, new Uint8Array([0x3b])], { type: "image/gif" }); }
}

const letters = (text) => [...text].map((letter) => letter.charCodeAt(0));
const word = (value) => [value & 255, value >> 8];

// The most frequent colours, told apart by 5 bits each of red, green and blue; every other one becomes the nearest of them.
function reduced(colours) {
  const count = new Uint32Array(32768), seen = new Uint32Array(32768), pixels = new Uint8Array(colours.length), palette = new Uint8Array(3 * COLOURS);
  const box = (colour) => ((colour >> 3) & 31) | ((colour >> 6) & 992) | ((colour >> 9) & 31744);
  for (const colour of colours) { count[box(colour)] += 1; seen[box(colour)] = colour; }
  const used = [...count.keys()].filter((one) => count[one]).sort((one, other) => count[other] - count[one]), place = new Uint8Array(32768);
  used.forEach((one, rank) => {
    const red = seen[one] & 255, green = (seen[one] >> 8) & 255, blue = (seen[one] >> 16) & 255;
    if (rank < COLOURS) { palette.set([red, green, blue], 3 * rank); place[one] = rank; return; }
    let least = Infinity;
    for (let i = 0; i < COLOURS; i++) {
      const far = (palette[3 * i] - red) ** 2 + (palette[3 * i + 1] - green) ** 2 + (palette[3 * i + 2] - blue) ** 2;
      if (far < least) { least = far; place[one] = i; }
    }
  });
  for (let i = 0; i < colours.length; i++) pixels[i] = place[box(colours[i])];
  return { palette, pixels };
}

// LZW: the longest known row of pixels becomes a code, and that row with the pixel after it is known from then on.
function compressed(pixels) {
  const clear = 1 << BITS, known = new Uint16Array((LAST + 1) << BITS), bytes = [];
  let size = BITS + 1, next = clear + 2, held = 0, bits = 0, row = pixels[0];
  const say = (code) => {
    held |= code << bits;
    for (bits += size; bits >= 8; bits -= 8) { bytes.push(held & 255); held >>>= 8; }
  };
  say(clear);
  for (let i = 1; i < pixels.length; i++) {
    const at = (row << BITS) | pixels[i];
    if (known[at]) { row = known[at]; continue; }
    say(row);
    row = pixels[i];
    if (next > LAST) { say(clear); known.fill(0); size = BITS + 1; next = clear + 2; continue; }
    if (next >> size) size += 1;
    known[at] = next++;
  }
  say(row);
  say(clear + 1);
  if (bits) bytes.push(held & 255);
  const blocks = [BITS];
  for (let i = 0; i < bytes.length; i += 255) { const part = bytes.slice(i, i + 255); blocks.push(part.length, ...part); }
  blocks.push(0);
  return new Uint8Array(blocks);
}
