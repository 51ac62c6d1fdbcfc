"""How much an answer leans on its priors, and what knowing more would be worth.

Cells of a sweep change one prior each. A cell is first answered by weighting the stored draws
(:mod:`.weights`, :mod:`.cells`), and fitted anew where the weights cannot be trusted. The model is
met through a small protocol (:mod:`.models`), so that totals and telemetry are swept alike.
"""
