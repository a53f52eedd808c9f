//! NIfTI files made by hand.

/// A NIfTI-1 file of bytes, with the sform given by its rows when there is one.
pub fn nifti(dims: [usize; 3], pixdim: [f32; 4], sform: Option<[[f32; 4]; 3]>, quaternion: Option<[f32; 6]>, voxels: &[u8]) -> Vec<u8> {
    let mut b = vec![0_u8; 352];
    let mut put = |at: usize, bytes: &[u8]| b[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348_i32.to_le_bytes());
    for (i, d) in [3, dims[0] as i16, dims[1] as i16, dims[2] as i16, 1, 1, 1, 1].iter().enumerate() {
        put(40 + 2 * i, &d.to_le_bytes());
    }
    put(70, &2_i16.to_le_bytes());
    put(72, &8_i16.to_le_bytes());
    for (i, p) in pixdim.iter().enumerate() {
        put(76 + 4 * i, &p.to_le_bytes());
    }
    put(108, &352_f32.to_le_bytes());
    put(123, &[2]);
    if let Some(q) = quaternion {
        put(252, &1_i16.to_le_bytes());
        for (i, v) in q.iter().enumerate() {
            put(256 + 4 * i, &v.to_le_bytes());
        }
    }
    if let Some(rows) = sform {
        put(254, &1_i16.to_le_bytes());
        for (i, v) in rows.iter().flatten().enumerate() {
            put(280 + 4 * i, &v.to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    b.extend_from_slice(voxels);
    b
}
