"""An attack on the package from outside: `python -m attack OUT`, in `tests`.

Each attempt gives something wrong, hostile or disturbed to astray, in a fork of one process that
has imported it, in a folder of its own, as a user who may write nowhere else. What did not end as
it should is flagged; all are in OUT/log.jsonl.

`core` has what an attempt is and how its end is judged, `forks` how it is run, `confined` as whom;
`material` has what is attacked with. The classes are in a module or a few each, and `checks` sees
that each way to fail is noticed.
"""
