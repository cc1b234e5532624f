"""The paper's figures made again, and its claims judged by them."""
