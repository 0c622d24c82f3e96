"""The simulations of the papers run again: what each prints, what comes out, and which of the two is wrong."""

PAPERS = {
    "wu2025": "Wu et al. 2025, lossless scalar calibration, Sensors 25, 2164",
    "li2018a": "Li et al. 2018, artificial vector calibration, Sensors 18, 361",
    "li2018b": "Li et al. 2018, fast rotation calibration, Optics and Precision Engineering 2018 (7), 1813",
    "chi2017": "Chi et al. 2017, integrated calibration for the cross magnetic gradiometer",
}
"""What is reproduced, by the names that the command line knows."""
