"""A patient's bone: surfaces, images and landmarks, and moduli by computed tomography.

`geometry` has the keys of `kind: patient`, `image_modulus` those of a density in an image, `bone`
the bone in the model's axes, `measured_layers` its layers in the sections of a mesh. Importing the
package registers it; the core does not know it.
"""

from app.patient import findings as findings
from app.patient.geometry import Patient as Patient
from app.patient.image_modulus import ImageModulus as ImageModulus
