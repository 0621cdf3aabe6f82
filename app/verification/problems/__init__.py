"""Problems with known answers: one pytest case each, by subject.

`conftest` gives them their ``problem``; `app.verification.problem` says what it can.
"""
