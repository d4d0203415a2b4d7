"""From one's own CT to a registered plan: the commands plan, touch and register.

Reading order: `case_files` (CT, labels, plan, touches), `structure_names`, `plan_run`,
`touch_run`, `register_run`.
"""
