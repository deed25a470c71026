"""TV Watcher (paper, section 5): a film's video, sound and captions, analysed and watched in step.

The roles are three producers, two analysers and one viewer. Each is a process, and they exchange data only through
channels. `orchestrator` starts the cluster and the roles, and collects their reports.
"""
