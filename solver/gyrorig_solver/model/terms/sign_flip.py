"""An axis counts the other way round: a sign in a driver, a board upside down.

y_i' = -y_i: the gain and the bias take it whole; a mirrored gain (one axis, or three) has a
negative determinant, which no mount makes.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Kind, Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import XYZ


class SignFlip(LinearTerm):
    """1 for an axis that is turned round, 0 for one that is not."""

    cause = "sign_flip"
    part: Part = "link"
    link: Link = "readout"
    kind: Kind = "gauge"
    parameters = (
        TermParameter("flipped", "1", typical=1.0, lower=0.0, upper=1.0, prior_std=1.0, parts=XYZ),
    )
    confused_with = ("axis_swap",)
    excitation = "any motion; compare the mount with the gain's nearest signed permutation"
    harm = "none to the calibration, which holds for the axes as they come; the mount is another"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return minus twice each axis, (3, blocks, 3)."""
        return by_axis(-2.0 * (scene.read(scene.filtered_rad_s) + scene.bias_rad_s))

    def sentence(self, values: FloatArray) -> str:
        """Say which axes."""
        said = [name for name, value in zip(XYZ, values, strict=True) if value > 0.5]
        return f"axes count the other way round: {', '.join(said) or 'none'}"


TERM = SignFlip()
