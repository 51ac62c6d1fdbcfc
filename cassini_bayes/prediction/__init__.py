"""Predicting the next wheel bias: on-times, pulses, ΔV, hydrazine and duration with intervals.

``docs/topics/prediction.md`` derives the model. :func:`learn` conditions it on past events,
:func:`predict` draws a planned bias, :mod:`.leave_one_out` puts it to the test, :mod:`.planning`
ranks biases by what they would teach, :mod:`.ground_software` is the published method to beat.
"""
