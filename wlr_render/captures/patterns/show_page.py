"""Folder for showing a code: the pictures, and a web page that shows them pixel by pixel on a panel."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.io.atomic_files import write_image, write_text

PAGE = "show.html"


def write_show_page(
    folder: str | Path, pattern: Pattern, channel: str | None = None, white_every: int | None = None
) -> list[Path]:
    """Write the pictures and the page.

    The page needs no other files. Opened on the panel as an external monitor, it shows the pictures with one picture
    pixel on one panel pixel. It advances at a click or a key, or every two seconds as `show.html?seconds=2`. Served by
    a `ShowServer`, it shows the pictures that the server selects.

    Args:
        folder: output folder; created if necessary.
        pattern: pattern to show.
        channel: primary of the pictures: "red", "green" or "blue"; None for white.
        white_every: number of pictures after which white is shown again, and at the end; None for once.

    Returns:
        Paths of the pictures in the order of showing, 000_white.png, 001_black.png, ...; without further whites, with
        the numbers of `Pattern.image`.
    """
    numbers: list[int] = []
    for number in range(len(pattern.names())):
        numbers += [0, number] if white_every and number > 1 and (number - 2) % white_every == 0 else [number]
    numbers += [0] if white_every else []
    names = [pattern.names()[number] for number in numbers]
    paths = [
        write_image(
            Path(folder) / f"{index:03d}_{name.replace(' ', '_')}.png",
            _in_primary(pattern.image(number), channel),
            [cv2.IMWRITE_PNG_COMPRESSION, 1],
        )
        for index, (number, name) in enumerate(zip(numbers, names, strict=True))
    ]
    pictures = [_embedded(path) for path in paths]
    size = f"{pattern.panel.width_px} x {pattern.panel.height_px}"
    content = {"names": names, "pictures": pictures, "width": pattern.panel.width_px, "height": pattern.panel.height_px}
    write_text(Path(folder) / PAGE, _HTML.replace("CONTENT", json.dumps(content)).replace("SIZE", size))
    return paths


def _in_primary(image: NDArray[np.uint8], channel: str | None) -> NDArray[np.uint8]:
    """Return the picture (h, w) unchanged for white, else (h, w, 3) in OpenCV's order blue, green, red."""
    if channel is None:
        return image
    coloured = np.zeros((*image.shape, 3), np.uint8)
    coloured[..., ("blue", "green", "red").index(channel)] = image
    return coloured


def _embedded(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


_HTML = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>Code for a panel of SIZE pixels</title>
<style>
  html, body { margin: 0; height: 100%; background: #000; overflow: hidden; cursor: none; }
  img { position: absolute; left: 0; top: 0; image-rendering: pixelated; }
  p { position: absolute; margin: 2em; max-width: 40em; font: 1rem/1.5 sans-serif; color: #fff; }
</style>
<img alt="" hidden>
<p></p>
<script>
"use strict";
const code = CONTENT;
const picture = document.querySelector("img"), text = document.querySelector("p");
const options = new URLSearchParams(location.search);
const seconds = Number(options.get("seconds") || 0), remote = options.has("remote");
let index = -1, timer = null, started = false, shown = -1;

// One picture pixel on one panel pixel, whatever zoom and scaling the system has.
function fit() {
  picture.style.width = code.width / devicePixelRatio + "px";
  picture.style.height = code.height / devicePixelRatio + "px";
}

function message() {
  const here = Math.round(innerWidth * devicePixelRatio) + " x " + Math.round(innerHeight * devicePixelRatio);
  text.textContent = code.names.length + " pictures for a panel of SIZE pixels; this window has " + here + ". " +
    (remote ? "Move it to the panel's screen and click for full screen; then the capture begins." :
    "Click for full screen and the first picture; then click or press any key for the next, Backspace or the left " +
    "arrow for the one before. With ?seconds=2 behind the address they change by themselves.");
}

function show(next) {
  index = Math.max(-1, Math.min(next, code.names.length));
  const shown = index >= 0 && index < code.names.length;
  picture.hidden = !shown;
  text.hidden = index >= 0;
  if (shown) { picture.src = code.pictures[index]; document.title = index + " " + code.names[index]; }
  if (index === code.names.length) { clearInterval(timer); timer = null; document.title = "all shown"; }
}

// Ask the server which picture to show, and tell it which one is on the screen.
async function poll() {
  const size = [innerWidth, innerHeight].map(length => Math.round(length * devicePixelRatio));
  try {
    const query = "?shown=" + shown + "&width=" + size[0] + "&height=" + size[1];
    const answer = await fetch("state" + query, {cache: "no-store"});
    if (answer.status === 404) { location.replace("/"); return; }  // another code is being captured
    const next = (await answer.json()).show;
    if (next !== shown) {
      show(next);
      if (!picture.hidden) await picture.decode();
      await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
      shown = next;
    }
  } catch (error) { console.log("no answer: " + error); }  // between two captures nothing serves the page
  setTimeout(poll, 100);
}

async function start() {
  const full = document.documentElement.requestFullscreen?.().catch(() => {});
  if (remote && !started) {
    started = true;
    await full;
    poll();
  } else if (!remote) {
    show(0);
    if (seconds > 0) timer = setInterval(() => show(index + 1), 1000 * seconds);
  }
}

addEventListener("resize", () => { fit(); message(); });
addEventListener("click", () => remote || index < 0 ? start() : show(index + 1));
addEventListener("keydown", event => {
  if (["Shift", "Control", "Alt", "Meta", "Escape", "F11"].includes(event.key)) return;
  event.preventDefault();
  if (remote) start();
  else if (event.key === "Backspace" || event.key === "ArrowLeft") show(index - 1);
  else if (index < 0) start();
  else show(index + 1);
});
fit();
message();
if (options.get("remote") === "now") start();
</script>
</html>
"""
