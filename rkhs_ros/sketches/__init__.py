"""Sketches of what is being learnt, in space: for the nodes that publish them and the pictures that draw them."""
