"""From one's own CT to a registered plan: the commands plan, touch and register.

Reading order: `case_files` (CT, labels and their names, plan, touches),
`plan_run` (its page: `plan_page`), `touch_run`, `register_run`.
"""
