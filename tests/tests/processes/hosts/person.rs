//! A person drives a robot whose controller is on another host.

use scanloop_tests::machine::repeat_when_late;

use super::TwoHosts;

#[test]
fn a_person_drives_by_a_controller_on_another_host_whose_clock_is_another() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::ahead("a person and a controller on another host") else { return };
        hosts.start(&["bend"]);
        let system = &hosts.system;
        system.wait_until("the robot drives", |system| {
            system.status().is_some_and(|status| status.state == "driving" && status.scan > 10)
        });
        assert_eq!(system.run(&["pause"]).status.code(), Some(0));
        let [x_m, y_m] = system.await_rest();
        let driven = system.run(&["teleop", "--velocity=0.4", "--steering=0.05", "--for=2.5"]);
        assert_eq!(driven.status.code(), Some(0), "{driven:?}");
        let [to_x_m, to_y_m] = system.await_rest();
        assert!((to_x_m - x_m).hypot(to_y_m - y_m) > 0.4, "({x_m}, {y_m}) to ({to_x_m}, {to_y_m})");
        assert_eq!(system.run(&["resume"]).status.code(), Some(0));
        assert_eq!(hosts.system.wait().code(), Some(0));
        let drove: Vec<_> =
            hosts.system.report().driver_changes.into_iter().map(|row| row.driven_by).collect();
        assert_eq!(drove, ["nobody", "person", "nobody", "controller"]);
    });
}
