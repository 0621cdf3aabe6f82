"""Problems with known answers: each is a case of pytest, in a file for its subject.

`conftest` gives them their ``problem``, which `app.verification.problem` describes.
"""
