"""The simulation: closed-loop wheel biases, slews and burns, and effects hidden in them.

It integrates the equations of motion of a rigid body with wheels and thrusters; it shares geometry
and pulse physics with the inference and nothing else. ``docs/simulation.md`` tells the physics.
"""
