//! What both the cargo-fuzz target and the stable test do with an input: push it through both decoders, then a real frame,
//! which must be understood after one zero.

use parfocal_protocol::frame::{Decoder, MAX_FRAME, encode};
use parfocal_protocol::message::{FromBoard, Request, Sequence, Session, ToBoard};

/// Runs one input. Panics only if the decoder is wrong.
pub fn run(input: &[u8]) {
    let (mut board, mut host) = (Decoder::new(), Decoder::new());
    for byte in input {
        let _ = board.push::<ToBoard>(*byte);
        let _ = host.push::<FromBoard>(*byte);
    }
    let message = ToBoard { session: Session(1), sequence: Sequence(2), request: Request::Status };
    let mut frame = [0; MAX_FRAME];
    let n = encode(&message, &mut frame).expect("a buffer of MAX_FRAME takes every message");
    let _ = board.push::<ToBoard>(0);
    let last = frame[..n].iter().filter_map(|byte| board.push::<ToBoard>(*byte)).last();
    assert_eq!(last, Some(Ok(message)));
}
