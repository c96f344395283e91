"""The service: `gyrorigd run` and the commands that communicate with it.

What to use when: `service_process.ServiceProcess` is the whole process.
`service_loop.ServiceLoop` is the loop on one opened rig, which also runs in simulated time.
`job_queue.enqueue_job` adds a session to the queue. `service_client.send_command` queries a
running service. docs/service.md is the page for operators.
"""
