"""Colours and sizes that all pictures share."""

# Wong, "Color blindness", Nature Methods 8 (2011): told apart in print and by every reader.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
SMALL = "small"
