"""Symbols of a circuit diagram as SVG. A `Sheet` collects them; positions are in points, x right and y down."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

STYLE = (
    "text{font:11px sans-serif;fill:#111;white-space:pre}.net{fill:#0645ad}.name{font-weight:bold}"
    ".head{font-size:15px;font-weight:bold}.mono{font-family:monospace}path,circle,rect{fill:none;stroke:#111;stroke-width:1.4}.solid{fill:#111}"
)
HALF = 30
"""Half the length of a part with two ends, between the points where wires meet it."""


class Sheet:
    """A sheet of symbols; `svg` returns its text.

    Each part is a group whose id is its designator, so that a test can compare sheets, netlists and bill of materials.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self.items: list[str] = []

    def svg(self) -> str:
        """Return the whole file."""
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}">'
        ground = f'<rect width="{self.width}" height="{self.height}" style="fill:#fff;stroke:none"/>'
        return "\n".join([head, f"<style>{STYLE}</style>", ground, *self.items, "</svg>", ""])

    def text(self, x: float, y: float, words: str, *, kind: str = "", anchor: str = "start") -> None:
        """Write words whose base line begins, ends or is centred at a point."""
        self.items.append(f'<text x="{x:g}" y="{y:g}" class="{kind}" text-anchor="{anchor}">{escape(words)}</text>')

    def path(self, data: str, kind: str = "") -> None:
        """Draw an SVG path."""
        self.items.append(f'<path d="{data}" class="{kind}"/>')

    def wire(self, *points: tuple[float, float]) -> None:
        """Join points by a line."""
        self.path("M" + "L".join(f"{x:g} {y:g}" for x, y in points))

    def dot(self, x: float, y: float) -> None:
        """Mark a joint of wires."""
        self.items.append(f'<circle cx="{x:g}" cy="{y:g}" r="2.6" class="solid"/>')

    def net(self, x: float, y: float, name: str, *, left: bool = False) -> None:
        """Name the net at a point; two points of one name are joined."""
        self.text(x - 3 if left else x + 3, y + 4, name, kind="net", anchor="end" if left else "start")

    def ground(self, x: float, y: float) -> None:
        """Draw ground below a point."""
        self.path(f"M{x} {y}v6M{x - 9} {y + 6}h18M{x - 6} {y + 10}h12M{x - 3} {y + 14}h6")

    def _part(self, name: str, data: str, words: Sequence[tuple[float, float, str, str]], kind: str = "") -> None:
        self.items.append(f'<g id="{escape(name)}">')
        self.path(data, kind)
        for x, y, line, anchor in words:
            self.text(x, y, line, kind="name" if line == name else "", anchor=anchor)
        self.items.append("</g>")

    def _ends(self, x: float, y: float, name: str, value: str, upright: bool) -> list[tuple[float, float, str, str]]:
        if upright:
            return [(x + 12, y - 1, name, "start"), (x + 12, y + 12, value, "start")]
        return [(x, y - 12, name, "middle"), (x, y + 22, value, "middle")]

    def resistor(self, x: float, y: float, name: str, value: str, *, upright: bool = False) -> None:
        """Draw a resistor about a point, 60 long."""
        body = (
            f"M{x - 30} {y}h12m0-6h36v12h-36zm36 6h12" if not upright else f"M{x} {y - 30}v12m-6 0v36h12v-36zm6 36v12"
        )
        self._part(name, body, self._ends(x, y, name, value, upright))

    def capacitor(self, x: float, y: float, name: str, value: str, *, upright: bool = False) -> None:
        """Draw a capacitor about a point, 60 long."""
        if upright:
            body = f"M{x} {y - 30}v27m-11 0h22m-22 6h22m-11 0v27"
        else:
            body = f"M{x - 30} {y}h27m0-11v22m6-22v22m0-11h27"
        self._part(name, body, self._ends(x, y, name, value, upright))

    def coil(self, x: float, y: float, name: str, value: str) -> None:
        """Draw a coil about a point, 60 long, lying."""
        self._part(name, f"M{x - 30} {y}h6" + "a6 6 0 0 1 12 0" * 4 + "h6", self._ends(x, y, name, value, False))

    def diode(self, x: float, y: float, name: str, value: str, *, turn: int = 0) -> None:
        """Draw a diode about a point, 60 long; it conducts to the right, with turn 90 down, -90 up."""
        body = "M-30 0h22M-8-9L8 0L-8 9zM8-9v18M8 0h22"
        self.items.append(f'<g id="{escape(name)}"><g transform="translate({x} {y}) rotate({turn})">')
        self.path(body)
        self.items.append("</g>")
        for wx, wy, line, anchor in self._ends(x, y, name, value, abs(turn) == 90):
            self.text(wx, wy, line, kind="name" if line == name else "", anchor=anchor)
        self.items.append("</g>")

    def transistor(self, x: float, y: float, name: str, value: str) -> None:
        """Draw an n-channel MOSFET: drain at (x, y - 30), source at (x, y + 30), gate at (x - 34, y)."""
        body = (
            f"M{x} {y - 30}v18h-18M{x} {y + 30}v-18h-18M{x - 18} {y - 17}v10m0 2v10m0 2v10M{x - 24} {y - 14}v28"
            f"M{x - 24} {y}h-10M{x - 18} {y}h18v12M{x - 18} {y}l6-4m-6 4l6 4"
        )
        self._part(name, body, [(x + 8, y - 2, name, "start"), (x + 8, y + 11, value, "start")])

    def amplifier(self, x: float, y: float, name: str, value: str) -> None:
        """Draw an amplifier or comparator: + at (x - 40, y - 15), - at (x - 40, y + 15), out at (x + 40, y)."""
        body = f"M{x - 30} {y - 34}v68l60-34zM{x - 40} {y - 15}h10M{x - 40} {y + 15}h10M{x + 30} {y}h10"
        body += f"M{x - 26} {y - 15}h8m-4-4v8M{x - 26} {y + 15}h8"
        self._part(name, body, [(x - 14, y + 4, name, "start"), (x + 2, y + 32, value, "start")])

    def box(self, x: float, y: float, name: str, value: str, size: tuple[float, float]) -> None:
        """Draw a block whose upper left corner is at a point."""
        words = [(x + size[0] / 2, y + 15, name, "middle"), (x + size[0] / 2, y + 28, value, "middle")]
        self._part(name, f"M{x} {y}h{size[0]}v{size[1]}h{-size[0]}z", words)
