//! An alarm wakes when it is due, and when somebody notifies.

use std::time::{Duration, Instant};

use ipc_types::{BatchHeader, DriveRequest, Message, WakeRole};
use runtime::Bus;
use runtime::run::RunNames;

#[test]
fn an_alarm_is_as_punctual_as_a_plain_sleep() {
    let names = RunNames::create().unwrap();
    let bus = Bus::create(&names, 1).unwrap();
    let alarm = bus.alarm(WakeRole::Vehicle).unwrap();
    let nap = Duration::from_millis(1);
    let median = |mut times: Vec<Duration>| {
        times.sort();
        times[times.len() / 2]
    };
    let time = |sleep: &dyn Fn()| {
        let since = Instant::now();
        sleep();
        since.elapsed()
    };
    let (mut alarms, mut sleeps) = (Vec::new(), Vec::new());
    for _ in 0..100 {
        alarms.push(time(&|| alarm.wait(nap)));
        sleeps.push(time(&|| std::thread::sleep(nap)));
    }
    // A socket's timeout would take four milliseconds here, or ten: the kernel's ticks.
    let (alarms, sleeps) = (median(alarms), median(sleeps));
    assert!(alarms >= nap && alarms < 2 * sleeps, "{alarms:?} against {sleeps:?}");

    // Who was notified before it sleeps does not sleep, and sleeps the next time.
    let requests = bus.outlet::<DriveRequest>().unwrap();
    assert!(DriveRequest::TOPIC.wakes.contains(&WakeRole::Vehicle));
    requests.send(BatchHeader::default(), 1, |_| DriveRequest::default()).unwrap();
    let long = Duration::from_secs(5);
    assert!(time(&|| alarm.wait(long)) < long / 2);
    assert!(time(&|| alarm.wait(nap)) >= nap);
    drop((requests, alarm, bus));
    names.remove();
}
