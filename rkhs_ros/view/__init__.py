"""A page in the browser that shows runs while they learn and afterwards, from what they leave in their folders."""
