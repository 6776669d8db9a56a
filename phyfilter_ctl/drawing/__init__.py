"""Block diagrams, drawn: python-control systems as pictures."""

from .draw import draw
from .picture import Drawing, Node, Port, Shape, Text, Wire

__all__ = ["Drawing", "Node", "Port", "Shape", "Text", "Wire", "draw"]
