"""BioTac fingertips in MuJoCo: 21 channels in `data.sensordata`, without a plugin.

    spec = mujoco.MjSpec.from_file("hand.xml")
    taxel.mujoco.add_sensor(spec, site="biotac")
    model = spec.compile()
    data = mujoco.MjData(model)
    tips = taxel.mujoco.Fingertips(model, predictor)
    while True:
        mujoco.mj_step(model, data)
        tips.step(data)  # data.sensor("biotac_taxel").data has the channels

The site is the sensor's frame (`taxel.skin`): x to the tip, z out of the nail. Needs MuJoCo 3.
"""

from taxel.errors import MissingDependency

try:
    from taxel.mujoco.fingertips import Fingertips, add_sensor
    from taxel.mujoco.site_contacts import SiteContacts
except ModuleNotFoundError as error:
    raise MissingDependency("taxel.mujoco", str(error.name), "mujoco") from None

__all__ = ["Fingertips", "SiteContacts", "add_sensor"]
