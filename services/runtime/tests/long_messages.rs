//! Messages that no process of ours sends.

use ipc_types::{BatchHeader, Rearm};
use runtime::Bus;
use runtime::run::RunNames;

#[test]
fn a_message_longer_than_any_of_ours_is_passed_over() {
    let names = RunNames::create().unwrap();
    let bus = Bus::create(&names, config::MAX_FLEET + 1).unwrap();
    let outlet = bus.outlet::<Rearm>().unwrap();
    let inlet = bus.inlet::<Rearm>().unwrap();
    let send = |len: usize| {
        outlet.send(BatchHeader::default(), len, |_| Rearm::default()).unwrap();
    };
    send(config::MAX_FLEET + 1);
    assert!(inlet.receive().unwrap().is_none());
    send(config::MAX_FLEET + 1);
    send(config::MAX_FLEET);
    assert_eq!(inlet.receive().unwrap().unwrap().items().len(), config::MAX_FLEET);
    drop((outlet, inlet, bus));
    names.remove();
}
