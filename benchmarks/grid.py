"""The cells of the Cart Pole."""

#: Table 5 of the paper: the edges of x, x_dot, theta and theta_dot lie between plus and minus these
POLE_BOUNDS = (2.4, 4.0, 0.2095, 4.0)
N_EDGES = 10
