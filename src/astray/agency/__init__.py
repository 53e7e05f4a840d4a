"""Agents and devices: is a policy goal-directed, and towards what?

After Langosco et al. 2022, Section 3.5 and Appendix B.1. An agent pursues a goal; a device maps
observations to actions; both err at random. Read `measure.py`, then `steps.py`.
"""
