"""Write every kind of output onto a disk with 0, 1, 2, ... free blocks; runs in a mount namespace of its own.

Prints what went wrong, and for each kind of output how often it was refused and how often written.
"""

import os
import subprocess
import sys
from pathlib import Path

from test_atomic_files import WRITERS

from wlr_render.errors import BadInputError

DISK = Path(sys.argv[1])
BLOCK = os.sysconf("SC_PAGE_SIZE")
MOST_STEPS = 6


def outcome(name: str, free_blocks: int, whole: bytes) -> bool:
    """Write over an old file with so many free blocks; returns whether it was written."""
    target, ballast = DISK / name, DISK / "ballast"
    target.write_bytes(b"old")
    with ballast.open("wb") as file:
        state = os.statvfs(DISK)
        os.posix_fallocate(file.fileno(), 0, max(1, state.f_bavail - free_blocks) * BLOCK)
    try:
        WRITERS[name](target)
        written = True
    except BadInputError as error:
        written = False
        if "\n" in str(error) or name not in str(error):
            print(f"{name} with {free_blocks} blocks: the sentence is {error}")
    content = target.read_bytes()
    if content != (whole if written else b"old"):
        print(f"{name} with {free_blocks} blocks: written is {written}, and the file has {len(content)} bytes")
    if left := {path.name for path in DISK.iterdir()} - {name, "ballast"}:
        print(f"{name} with {free_blocks} blocks: {left} is left")
    target.unlink()
    ballast.unlink()
    return written


subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "none", DISK], check=True)
for name in WRITERS:
    target = DISK / name
    WRITERS[name](target)
    whole = target.read_bytes()
    target.unlink()
    blocks = -(-len(whole) // BLOCK)
    sizes = range(0, blocks + 2, -(-blocks // MOST_STEPS))
    written = [outcome(name, free_blocks, whole) for free_blocks in [*sizes, 2 * blocks + 4]]
    print(f"{name}: refused {written.count(False)}, written {written.count(True)}", file=sys.stderr)
    if not (written[-1] and not written[0]):
        print(f"{name}: written is {written}")
