"""EXR files as other programs write them: channels of any names and values."""

import numpy as np
import OpenEXR


def write_other_exr(path, channels, **header):
    """Write planes by channel name, or (H, W, 3) as "RGB"; `header` has further attributes."""
    whole = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    planes = {name: np.ascontiguousarray(one, np.float32) for name, one in channels.items()}
    OpenEXR.File(whole, planes).write(str(path))
    return path
