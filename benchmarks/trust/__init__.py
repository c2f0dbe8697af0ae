"""How far a calibration may be trusted when the data are not as the model says (part `trust`).

`scenes` has cameras, sky, attitudes and telemetry that share no code with the product, `faults` what can be wrong in them,
`measure` what is told of it, and `tables` the tables of that.
"""
