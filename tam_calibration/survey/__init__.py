"""From a recording and its calibration to the source in it."""

from tam_calibration.survey.alternating import locate_alternating
from tam_calibration.survey.locate import locate
from tam_calibration.survey.result import Line, Overall, Survey
from tam_calibration.survey.steady import locate_steady

__all__ = ["Line", "Overall", "Survey", "locate", "locate_alternating", "locate_steady"]
