"""Vehicle campaigns of TU Ilmenau: their HDF5 files and what a user knows of them in, a campaign out.

`campaign.py` is the adapter, `sheet.py` what is asked of the user, `layout.py` the rules of the files, `responses.py`
the paths that our own estimator finds in frequency responses.
"""
