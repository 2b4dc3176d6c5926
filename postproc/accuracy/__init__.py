"""Speed against accuracy: the ladder of models, where methods fail, and what a run can promise.

`python -m postproc.accuracy` makes charts and tables (`make accuracy` calls it). Each part is a
module of this package with `run(study)`: it makes its runs, stores its numbers, writes its tables
and draws its figures in the study's folder. With `--publish` these are copied beside
docs/accuracy.md.
"""
