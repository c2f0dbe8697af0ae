"""Images written as files of each kind, by the libraries that own the formats."""

import numpy as np
from astropy.io import fits


def write_fits(path, image, **changes):
    header = fits.Header()
    header["DATE-OBS"] = str(image.time_utc - np.timedelta64(250, "ms"))
    header["EXPTIME"] = 0.5
    header["EGAIN"] = 1.0
    for key, value in changes.items():
        header[key.replace("_", "-")] = value
    fits.writeto(path, image.dn, header)
    return path
