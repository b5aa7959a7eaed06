"""An independent second opinion on a finished plan: everything is re-derived from the document itself.

Nothing here uses the planners' kernels. Forward kinematics comes from pinocchio, collision from python-fcl on the
unreduced hulls of the robots' meshes, balances are assembled again in the world frame.

`certify` reads the document (`plan_view`), gathers what follows from it (`evidence`) and has the checks of its kind
made: those of `lift` or `tool`, and the laws that both obey, `common`. Below them lie `motion`, where everything is at
every moment and what hits what, and `geometry`, the shapes of bodies.
"""

from planners.certify.certify import certify
from planners.certify.evidence import CellReference, LifterReference
from planners.certify.geometry.mesh_files import load_meshes
from planners.certify.motion.robot_surfaces import RobotSurfaces, load_surfaces
from planners.certify.settings import CertifySettings
from planners.plan.verdicts import Certificate, Check

__all__ = [
    "CellReference",
    "Certificate",
    "CertifySettings",
    "Check",
    "LifterReference",
    "RobotSurfaces",
    "certify",
    "load_meshes",
    "load_surfaces",
]
