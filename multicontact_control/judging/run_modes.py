"""How a run was made, and how it ended: the words that ``summary.json`` has for it."""

IN_PROCESS = 'in_process'  # in one process, without ROS
LOCKSTEP = 'lockstep'  # on a graph whose simulator waits for the answer to a sample
REAL_TIME = 'free_running'  # on a graph whose simulator does not wait
EXTERNAL_RUN = 'external'  # with the user's own robot behind the topics
RECORDED = 'recorded'  # a recording of a controller
INTERRUPTED = 'interrupted by a signal'  # an end that is no failure of the run
