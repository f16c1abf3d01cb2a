"""The page's GIF: what Pillow reads is what was filmed. The page's own module runs in Node."""

import base64
import io

import numpy as np
from PIL import Image

from tests.node import needs_node, node

pytestmark = needs_node
WIDTH, HEIGHT = 120, 90


def filmed(frames: list[np.ndarray]) -> Image.Image:
    """The GIF that the page makes of frames [HEIGHT, WIDTH, 3], a tenth of a second each."""
    opaque = [np.dstack([frame, np.full((HEIGHT, WIDTH), 255)]).astype(np.uint8).tobytes() for frame in frames]
    said = node(
        f"""(() => {{
          const gif = new Gif({WIDTH}, {HEIGHT});
          for (const frame of data) gif.add(new Uint8ClampedArray(Buffer.from(frame, "base64")), 0.1);
          return Buffer.concat([...gif.parts, Buffer.from([0x3b])]).toString("base64");
        }})()""",
        [base64.b64encode(frame).decode() for frame in opaque],
        "gif",
    )
    return Image.open(io.BytesIO(base64.b64decode(said)))


def decoded(film: Image.Image) -> list[np.ndarray]:
    """Its frames, [HEIGHT, WIDTH, 3] each."""
    found = []
    for number in range(film.n_frames):
        film.seek(number)
        found.append(np.asarray(film.convert("RGB")).astype(int))
    return found


def test_frames_of_few_colours_come_back_as_they_are() -> None:
    rng = np.random.default_rng(8)
    palette = 8 * rng.permutation(32**3)[:200]
    colours = np.stack([palette // 8 % 32, palette // 256 % 32, palette // 8192], axis=-1) * 8
    frames = [colours[rng.integers(0, 200, (HEIGHT, WIDTH))] for _ in range(3)]  # noise: the codes run out many times
    frames.append(np.zeros((HEIGHT, WIDTH, 3), int))  # and one long row
    film = filmed(frames)
    assert film.size == (WIDTH, HEIGHT) and film.n_frames == 4 and film.info["duration"] == 100 and film.info["loop"] == 0
    for said, meant in zip(decoded(film), frames):
        np.testing.assert_array_equal(said, meant)


def test_frames_of_many_colours_come_back_nearly() -> None:
    east, north = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    frame = np.dstack([255 * east // WIDTH, 255 * north // HEIGHT, 255 * (east + north) // (WIDTH + HEIGHT)])
    (said,) = decoded(filmed([frame, np.zeros_like(frame)]))[:1]
    assert np.abs(said - frame).mean() < 12 and np.abs(said - frame).max() < 64
