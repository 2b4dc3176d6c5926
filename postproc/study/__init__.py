"""A study: runs of the program and its probes, stored in a folder, tables and pictures.

`Study` is used by the script of a study; `main` is its command line.
"""

from postproc.study.study import Study, add_options, chosen_parts, main, study_of

__all__ = ["Study", "add_options", "chosen_parts", "main", "study_of"]
