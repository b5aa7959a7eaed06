"""An independent second opinion on a finished plan: everything is re-derived from the document itself.

Nothing here uses the planners' kernels. Forward kinematics comes from pinocchio, collision from python-fcl on the
unreduced hulls of the robots' meshes, balances are assembled again in the world frame.
"""

from planners.certify.certify import certify
from planners.certify.evidence import CellReference
from planners.certify.motion.robot_surfaces import RobotSurfaces, load_surfaces
from planners.certify.settings import CertifySettings
from planners.plan.verdicts import Certificate, Check

__all__ = ["CellReference", "Certificate", "CertifySettings", "Check", "RobotSurfaces", "certify", "load_surfaces"]
