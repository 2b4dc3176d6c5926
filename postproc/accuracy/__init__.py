"""Speed against accuracy: the ladder of models, where methods fail, and what a run can promise.

`python -m postproc.accuracy` makes it all (`make accuracy` calls it). Each part is a module of this
package with `run(job)`: it does its runs (`job.battery`), draws its figures into `job.folder` and
keeps its numbers with `job.keep(part, numbers)`. The page of the docs is written from these numbers
alone, by `page`, its template `page.md` and `sections`.
"""
