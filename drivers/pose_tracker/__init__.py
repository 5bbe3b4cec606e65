"""Motion capture of a laboratory: position and attitude of a frame on the vehicle, by MAVLink 2 on a serial line.

Sources: MAVLink 2 serialisation (mavlink.io/en/guide/serialization.html) and message 138, ATT_POS_MOCAP, of the common
dialect. Motion capture programs send it by their bridges to flight controllers. Known limits: signatures are not
checked; a clock of another computer stamps the poses, so their times come from arrival; what the tracker does not see
it does not send, so a drop-out is no lost message.
"""

from drivers.pose_tracker.device import PoseTracker
from drivers.pose_tracker.frame import PoseTrackerConfig, decode_message, decode_pose, message_stream

__all__ = ["PoseTracker", "PoseTrackerConfig", "decode_message", "decode_pose", "message_stream"]
