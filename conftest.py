"""For every test: Ctrl-C works, also where the run is a job in the background of a shell."""

import signal

# Such a job ignores SIGINT, and so would every process that a test starts and ends with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
