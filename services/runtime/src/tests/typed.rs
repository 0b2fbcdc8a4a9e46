//! The bus as other processes use it: ports of iceoryx2 for one type of samples each.
#![expect(unsafe_code, reason = "iceoryx2 marks types that may cross a process border by an unsafe trait")]

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{PortFactory, ServiceName, ZeroCopySend, ipc};
use iceoryx2::service::builder::publish_subscribe::Builder;
use iceoryx2::service::port_factory::publish_subscribe;
use shared_types::{Command, Pose, Role, Sample, SampleType, Scan, Topic};

use super::{Lab, pose};
use crate::input::Input;
use crate::output::Output;
use crate::port::{self, Samples};
use crate::{Bus, Observer};

/// A sample under its own name instead of its Rust path.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
pub(super) struct Wire<S>(pub(super) S);

// SAFETY: a `Sample` is `Pod`: fixed layout, no pointers, no padding, every bit pattern valid; and
// `repr(transparent)` makes the wrapper the same bytes.
unsafe impl<S: Sample> ZeroCopySend for Wire<S> {
    unsafe fn type_name() -> &'static str {
        S::TYPE_NAME
    }
}

/// A service of one type.
type Typed<S> = publish_subscribe::PortFactory<ipc::Service, Wire<S>, ()>;

fn builder<S: Sample>(bus: &Bus, name: &str) -> Builder<Wire<S>, (), ipc::Service> {
    bus.node().service_builder(&ServiceName::new(name).unwrap()).publish_subscribe::<Wire<S>>()
}

fn typed<S: Sample>(bus: &Bus) -> Typed<S> {
    builder(bus, S::TOPIC.name()).open().unwrap()
}

fn untyped<S: Sample>(bus: &Bus, name: &str) -> Samples {
    let detail = port::of_samples(&S::TYPE.into()).unwrap();
    port::samples(bus.node(), &ServiceName::new(name).unwrap(), &detail).open().unwrap()
}

pub(super) fn publisher<S: Sample>(bus: &Bus) -> Publisher<ipc::Service, Wire<S>, ()> {
    typed::<S>(bus).publisher_builder().create().unwrap()
}

pub(super) fn subscriber<S: Sample>(bus: &Bus) -> Subscriber<ipc::Service, Wire<S>, ()> {
    typed::<S>(bus).subscriber_builder().create().unwrap()
}

#[test]
fn a_service_describes_its_samples_as_a_typed_one_does() {
    fn assert_same<S: Sample>(lab: &Lab) {
        let ours = untyped::<S>(lab.bus(), S::TOPIC.name());
        assert_eq!(ours.static_config(), typed::<S>(lab.bus()).static_config());
        // Opening compares less than everything, so a typed service is made as well.
        let name = format!("typed-{}", S::TOPIC);
        let theirs = builder::<S>(lab.bus(), &name).create().unwrap();
        let expected = theirs.static_config().message_type_details();
        assert_eq!(ours.static_config().message_type_details(), expected, "{}", S::TYPE_NAME);
        assert_eq!(untyped::<S>(lab.bus(), &name).static_config(), theirs.static_config());
    }
    let lab = Lab::new();
    assert_same::<Scan>(&lab);
    assert_same::<Pose>(&lab);
    assert_same::<Command>(&lab);
}

#[test]
fn samples_of_another_size_or_alignment_are_refused() {
    let lab = Lab::new();
    let name = ServiceName::new(Topic::Pose.name()).unwrap();
    let open = |of: &SampleType| {
        let detail = port::of_samples(&of.into()).unwrap();
        port::samples(lab.bus().node(), &name, &detail).open()
    };
    let pose = Pose::TYPE;
    assert!(open(pose).is_ok());
    assert!(open(&SampleType { size: pose.size + 8, ..*pose }).is_err());
    assert!(open(&SampleType { alignment: 2 * pose.alignment, ..*pose }).is_err());
    assert!(open(&SampleType { name: "scanloop.Pose.v0", ..*pose }).is_err());
}

#[test]
fn samples_of_typed_ports_are_received_and_those_of_ours_by_typed_ports() {
    let lab = Lab::new();
    let (ours, theirs) = (
        Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap(),
        publisher::<Pose>(lab.bus()),
    );
    let (input, observer, subscriber) = (
        Input::<Pose>::new(lab.bus(), lab.shared(Role::Controller, 9)).unwrap(),
        Observer::<Pose>::new(lab.bus()).unwrap(),
        subscriber::<Pose>(lab.bus()),
    );
    input.reader().drain().unwrap();
    ours.publish(&mut pose(1, 1.5)).unwrap();
    ours.publish_in_place(|place| (place.header.scan_id, place.x_m) = (2, 2.5)).unwrap();
    let mut sample = pose(3, 3.5);
    (sample.header.layout, sample.header.incarnation, sample.header.sequence) = (Pose::LAYOUT, 7, 3);
    theirs.loan_uninit().unwrap().write_payload(Wire(sample)).send().unwrap();
    input.reader().drain().unwrap();
    let expected = [(1, 1.5), (2, 2.5), (3, 3.5)];
    let taken = std::iter::from_fn(|| input.take()).map(|pose| (pose.header.scan_id, pose.x_m));
    assert_eq!(taken.collect::<Vec<_>>(), expected);
    let received = std::iter::from_fn(|| subscriber.receive().unwrap())
        .map(|sample| (sample.payload().0.header.scan_id, sample.payload().0.x_m));
    assert_eq!(received.collect::<Vec<_>>(), expected);
    let mut observed = Vec::new();
    observer.poll(|pose| observed.push((pose.header.scan_id, pose.x_m))).unwrap();
    assert_eq!(observed, expected);
}
