"""Plans as programs: what a controller, ROS or a spreadsheet takes, made of a certified plan and of nothing else.

`guard` decides whether a document may become a program at all, `schedule` reads it as steps that both arms do at the
same time, and a writer each for Universal Robots' controllers (`urscript`), for ROS 2 (`ros2`) and for tables (`table`)
writes them down.
"""

from planners.program.archive import ProgramTarget, write_program
from planners.program.guard import NotExportable, exportable
from planners.program.schedule import Schedule

__all__ = ["NotExportable", "ProgramTarget", "Schedule", "exportable", "write_program"]
