"""From one's own CT to a registered plan: the commands plan, touch and register.

Reading order: `case_files` (CT and labels), `plan_run`, `plan_table`,
`plan_page`, `touch_file`, `touch_run`, `register_run`, `register_report`.
"""
