"""How transitions are made and learned from."""
