"""A study: runs of the program and questions to its probes, kept in a folder, tables and pictures.

`Study` is what a script that answers a question uses; `main` is its command line.
"""

from postproc.study.study import Study, add_options, chosen_parts, main, study_of

__all__ = ["Study", "add_options", "chosen_parts", "main", "study_of"]
