//! The decoder against everything that is not a frame: it never panics and is in step again at the next frame.

use parfocal_protocol::frame::{DecodeError, Decoder, MAX_FRAME, encode, encode_version};
use parfocal_protocol::message::{FromBoard, Request, Role, Sequence, Session, ToBoard};
use proptest::prelude::*;

#[path = "../fuzz/body.rs"]
mod body;

fn hello(sequence: u32) -> ToBoard {
    ToBoard { session: Session(7), sequence: Sequence(sequence), request: Request::Hello { role: Role::Control } }
}

fn frame(message: &ToBoard) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    let n = encode(message, &mut buffer).unwrap();
    buffer[..n].to_vec()
}

fn decode_all(bytes: &[u8]) -> Vec<Result<ToBoard, DecodeError>> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|b| decoder.push(*b)).collect()
}

/// Ten million inputs by seed: the same body as the cargo-fuzz target's, without its compiler.
#[test]
fn ten_million_inputs_without_a_panic() {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut input = [0u8; 48];
    let real = frame(&hello(1));
    for round in 0u64..10_000_000 {
        // xorshift64*: https://doi.org/10.18637/jss.v008.i14
        for word in input.chunks_mut(8) {
            state ^= state >> 12;
            state ^= state << 25;
            state ^= state >> 27;
            word.copy_from_slice(&state.wrapping_mul(0x2545_F491_4F6C_DD1D).to_le_bytes());
        }
        let len = (state % 48) as usize;
        // Every other input is a real frame with up to two damaged bytes: noise alone rarely passes the COBS layer.
        if round % 2 == 0 {
            let n = real.len();
            let (at, with, also) = (usize::from(input[0]) % n, input[1], usize::from(input[2]) % n);
            input[..n].copy_from_slice(&real);
            input[at] = with;
            input[also] ^= (round % 5) as u8;
            body::run(&input[..n]);
        } else {
            body::run(&input[..len]);
        }
    }
}

proptest! {
    #[test]
    fn after_any_garbage_the_next_frame_but_one_is_understood(garbage in prop::collection::vec(any::<u8>(), 0..600)) {
        let mut bytes = garbage;
        // The first zero ends whatever the garbage began.
        bytes.push(0);
        bytes.extend(frame(&hello(5)));
        prop_assert_eq!(decode_all(&bytes).pop(), Some(Ok(hello(5))));
    }

    #[test]
    fn a_damaged_frame_is_never_taken_for_another_message(at in 0usize..14, flip in 1u8..=255) {
        let mut bytes = frame(&hello(5));
        let at = at % (bytes.len() - 1);
        bytes[at] ^= flip;
        for decoded in decode_all(&bytes) {
            prop_assert!(decoded.is_err(), "{decoded:?}");
        }
    }
}

#[test]
fn other_versions_are_told_apart_from_noise() {
    let mut buffer = [0; MAX_FRAME];
    let n = encode_version(9, &hello(1), &mut buffer).unwrap();
    assert_eq!(decode_all(&buffer[..n]), [Err(DecodeError::OtherVersion(9))]);
    buffer[3] ^= 0x20;
    assert_eq!(decode_all(&buffer[..n]), [Err(DecodeError::Damaged)]);
}

#[test]
fn a_sound_frame_with_an_unknown_message_is_told_apart_too() {
    let mut buffer = [0; MAX_FRAME];
    let n = encode(&(7u32, 1u32, 200u8), &mut buffer).unwrap();
    assert_eq!(decode_all(&buffer[..n]), [Err(DecodeError::UnknownMessage)]);
}

#[test]
fn endless_garbage_is_one_error_and_takes_no_memory() {
    let mut bytes = vec![0x55; 5000];
    bytes.push(0);
    assert_eq!(decode_all(&bytes), [Err(DecodeError::TooLong)]);
}

#[test]
fn the_longest_messages_fit_a_frame() {
    // FromBoard's longest member is a status; its size is checked by the compiler in `MAX_PLAIN`, here by writing one.
    let mut buffer = [0; MAX_FRAME];
    let reply = FromBoard::Reply {
        session: Session(u32::MAX),
        sequence: Sequence(u32::MAX),
        result: Err(parfocal_protocol::message::Refusal::NoSession),
    };
    assert!(encode(&reply, &mut buffer).is_ok());
    assert!(encode(&reply, &mut [0; 4]).is_err());
}
