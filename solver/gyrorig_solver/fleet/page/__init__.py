"""The fleet's page: alerts, tables and drift charts in static HTML and JavaScript.

What to use when: `alerts.fleet_alerts` for the alerts as sentences, `fleet_page.write_fleet_page`
for the page. Its HTML, style sheet and scripts are in `web/`.
"""

from gyrorig_solver.fleet.page.alerts import Alert, fleet_alerts
from gyrorig_solver.fleet.page.fleet_page import write_fleet_page

__all__ = [
    "Alert",
    "fleet_alerts",
    "write_fleet_page",
]
