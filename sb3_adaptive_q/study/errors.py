"""What can go wrong with a study, told to the user without a traceback."""


class StudyError(Exception):
    """A study cannot go on, for a reason outside its code: the disk, the cluster, a worker, a file."""


class DesignError(StudyError, ValueError):
    """What was asked for makes no study: an unknown name, a number out of range, a folder with other settings."""
