"""A second simulator, for recordings that the product is judged by: it shares no code and no method with the product.

Every body has three coordinates, the sprung frame too, and nothing is closed: all turning joints are contacts of pin
and socket (linear, or Hertzian with hysteresis, both with friction), guides and mounts are springs and dampers. The
drive's angle is prescribed. Fixed steps of 2 us, second order, forces taken once a step.

Read :mod:`second_simulator.protocols` for what the recordings are of, and :mod:`second_simulator.individual` for how a
machine differs from its file in every one of them. ``python -m second_simulator --help`` makes them.
"""
