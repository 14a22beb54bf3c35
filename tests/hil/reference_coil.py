"""The coil of 0.298 m with 19 turns (maths.md, 2), as scenarios of a few boards have it."""

COIL = """\
[coil]
turns = 19
radius_m = 0.149
current_A = 10.0
inductance_H = 1.9e-4
resistance_Ohm = 0.15
supply_V = 120.0
axis = [0.0, 0.0, 1.0]
"""
