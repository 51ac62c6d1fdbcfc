"""A mission: many events of either thruster branch, and what changed between them.

``docs/topics/mission.md`` derives the model. A mission is a sum of the models of its events
(:mod:`cassini_bayes.model`), whose thrusts share a few coefficients: levels at a reference
pressure, ageing, and losses that set in at an unknown event.
"""
