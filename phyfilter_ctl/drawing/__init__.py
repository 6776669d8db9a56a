"""Block diagrams, drawn: python-control systems as pictures."""

from .draw import draw
from .marks import Node, Port, Shape, Text, Wire
from .picture import Drawing

__all__ = ["Drawing", "Node", "Port", "Shape", "Text", "Wire", "draw"]
