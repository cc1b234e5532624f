"""The algorithms, one page each, and what they share: critics, step rules, and the function spaces they search."""
