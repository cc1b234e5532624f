"""3D sketches of episodes and policies, for nodes that publish them and pictures that draw them."""
