"""Type and value that ROS reads from a single value of a parameter file."""

import ctypes
import re

_TRUE = {"y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_DOTTED = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_TEXT_TAG = "tag:yaml.org,2002:str"

Single = bool | int | float | str


def read_value(text: str, style: str = "", tag: str | None = None) -> Single:
    """Return a single value with the type that ROS reads it as."""
    if tag == _TEXT_TAG or style in ("'", '"'):
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    whole = _whole_number(text)
    if whole is not None:
        return whole
    dotted = _DOTTED.fullmatch(text)
    number = _number(text.replace(".", "") if dotted else text)
    return text if number is None else number


# ROS converts by these two functions: hexadecimal, octal, what is too large, and so on.
_C = ctypes.CDLL(None, use_errno=True)
_C.strtoll.restype = ctypes.c_longlong
_C.strtoll.argtypes = [ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p), ctypes.c_int]
_C.strtod.restype = ctypes.c_double
_C.strtod.argtypes = [ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p)]


def _whole_number(text: str) -> int | None:
    data, rest = text.encode("utf-8", "replace"), ctypes.c_char_p()
    ctypes.set_errno(0)
    value: int = _C.strtoll(data, ctypes.byref(rest), 0)
    return value if data and not ctypes.get_errno() and rest.value == b"" else None


def _number(text: str) -> float | None:
    data, rest = text.encode("utf-8", "replace"), ctypes.c_char_p()
    ctypes.set_errno(0)
    value: float = _C.strtod(data, ctypes.byref(rest))
    return value if data and not ctypes.get_errno() and rest.value == b"" else None
