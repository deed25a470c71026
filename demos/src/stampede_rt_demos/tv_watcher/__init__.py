"""TV Watcher (paper, section 5): a film's video, sound and captions, analysed and watched in step.

Every role is a process of its own and they meet only in the channels: three producers, two analysers, one viewer.
`orchestrator` starts the cluster and the roles, and collects what they report.
"""
