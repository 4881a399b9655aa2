"""Colours of a page by day and by night: a figure's colours as CSS variables, and what they are on a dark page.

Greys change places, from paper to ink and back. Other colours keep their hue and become lighter until they stand out.
"""

import colorsys
import re

from matplotlib.colors import to_hex, to_rgb

PAPER, INK = "#14171a", "#e4e7ea"
"""Of a dark page."""
# Contrast of a line or a mark with what it lies on, at least: WCAG 2.2, success criterion 1.4.11.
_CONTRAST = 3.5
_GREY = 0.12  # spread of red, green and blue below which a colour is a grey
_STEP = 0.02
_IN_STYLE = re.compile(r"(fill|stroke|stop-color): (#[0-9a-f]{6})\b")
_VARIABLE = re.compile(r"var\(--x([0-9a-f]{6}),")


def contrast(first: str, second: str) -> float:
    """The contrast of two colours by WCAG 2.2, from 1 to 21."""

    def luminance(colour: str) -> float:
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in to_rgb(colour)]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    darker, lighter = sorted((luminance(first), luminance(second)))
    return (lighter + 0.05) / (darker + 0.05)


def dark(colour: str) -> str:
    """What a colour of a white page is on a dark one; both as #rrggbb."""
    red, green, blue = to_rgb(colour)
    if max(red, green, blue) - min(red, green, blue) < _GREY:
        # White becomes the page, black the ink.
        lightness = (red + green + blue) / 3
        parts = zip(to_rgb(PAPER), to_rgb(INK), strict=True)
        red, green, blue = (ink + lightness * (paper - ink) for paper, ink in parts)
        return to_hex((red, green, blue))
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    while contrast(colour, PAPER) < _CONTRAST and lightness < 1:
        lightness += _STEP
        colour = to_hex(colorsys.hls_to_rgb(hue, min(lightness, 1), saturation))
    return colour.lower()


def as_variables(svg: str) -> str:
    """An SVG whose colours are CSS variables, which fall back to what they were."""
    return _IN_STYLE.sub(lambda found: f"{found[1]}: var(--x{found[2][1:]}, {found[2]})", svg)


def at_night(page: str) -> str:
    """CSS that says what the variables of a page's figures are in the dark."""
    named = sorted({*_VARIABLE.findall(page)})
    return " ".join(f"--x{name}: {dark('#' + name)};" for name in named)
