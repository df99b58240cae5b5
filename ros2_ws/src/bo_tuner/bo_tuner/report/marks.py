"""One colour and one mark for each of what many figures show."""

from bo_tuner.figures.figure import Color, Marker

RESULT = (Color.BLUE, Marker.STAR)
DEFAULT = (Color.ORANGE, Marker.SQUARE)
OVER_LIMIT = (Color.VERMILION, Marker.TRIANGLE)
OFF_SCALE = (Color.PURPLE, Marker.DIAMOND)
