//! Stores as folders of this machine, whose objects are files.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use realitysim_remote::{Address, Copies, ObjectStores, PartCache, copy_of};

fn store_in(folder: &Path) -> Address {
    Address::parse(&format!("file://{}", folder.display())).unwrap()
}

fn room() -> (TempDir, ObjectStores) {
    (tempfile::tempdir().unwrap(), ObjectStores::new().unwrap())
}

#[test]
fn an_address_names_a_bucket_and_no_password() {
    for text in ["s3://bucket/captures/", "gs://bucket", "az://container/x", "https://host/captures", "file:///tmp"] {
        let address = Address::parse(text).unwrap();
        assert_eq!(address.as_str(), text.trim_end_matches('/'));
        assert!(Address::is_address(text));
    }
    for text in ["captures", "s3:bucket", "s3://", "https://a:b@host/x", "s3://bucket/x?y", "ftp://host/x"] {
        let said = Address::parse(text).unwrap_err().to_string();
        assert!(said.starts_with(text), "{said}");
    }
}

#[test]
fn a_long_file_comes_back_as_it_went() {
    let (folder, stores) = room();
    let bytes: Vec<u8> = (0..20_000_000_u32).map(|i| (i.wrapping_mul(i) >> 7) as u8).collect();
    let file = folder.path().join("long");
    fs::write(&file, &bytes).unwrap();
    fs::create_dir(folder.path().join("store")).unwrap();
    let to = store_in(&folder.path().join("store")).join("a/long");
    let mut sent = 0;
    stores.upload(&file, &to, &mut |bytes| sent = bytes).unwrap();
    assert_eq!(sent, bytes.len() as u64);
    assert!(stores.read(&to, 1 << 30).unwrap() == bytes);
    assert_eq!(stores.read_range(&to, 9_000_000..9_000_010).unwrap(), bytes[9_000_000..9_000_010]);
    assert!(stores.read(&to, 1000).unwrap_err().to_string().contains("at most 1000"));
    assert!(stores.read(&store_in(folder.path()).join("no"), 1000).unwrap_err().is_absent());
}

#[test]
fn a_cache_keeps_to_its_bound_and_to_the_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let address = Address::parse("s3://bucket/x").unwrap();
    let cache = PartCache::open(folder.path(), 10_000).unwrap();
    let part = |number: u8| vec![number; 1000];
    for number in 0..50 {
        cache.put(&address, number.into(), crc32fast::hash(&part(number)), &part(number));
        let held: u64 = fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().metadata().unwrap().len()).sum();
        assert!(held <= 10_000, "{held}");
    }
    let crc = crc32fast::hash(&part(49));
    assert_eq!(cache.get(&address, 49, 1000, crc), Some(part(49)));
    assert_eq!(cache.get(&address, 49, 1000, crc + 1), None);
    assert_eq!(cache.get(&address, 0, 1000, crc32fast::hash(&part(0))), None);
    // Damage is no part.
    for file in fs::read_dir(folder.path()).unwrap() {
        fs::write(file.unwrap().path(), [0; 1000]).unwrap();
    }
    assert_eq!(cache.get(&address, 49, 1000, crc), None);
}

#[test]
fn a_copy_follows_what_it_is_a_copy_of() {
    let (folder, stores) = room();
    let (there, here) = (folder.path().join("there"), folder.path().join("here"));
    fs::create_dir_all(there.join("inner")).unwrap();
    fs::write(there.join("a"), "one").unwrap();
    fs::write(there.join("inner/b"), "two").unwrap();
    let copies = Copies::new(&here, 1 << 20);
    let copy = || {
        let mut bytes = 0;
        let path =
            copy_of(&stores, &Copies::new(&here, 1 << 20), &store_in(&there), &mut |done, _| bytes = done).unwrap();
        (path, bytes)
    };
    let (path, bytes) = copy();
    assert_eq!((fs::read_to_string(path.join("inner/b")).unwrap().as_str(), bytes), ("two", 6));
    assert_eq!(copy().1, 0, "nothing has changed");
    fs::write(there.join("a"), "three").unwrap();
    fs::remove_file(there.join("inner/b")).unwrap();
    assert_eq!(copy().1, 5);
    assert_eq!(fs::read_to_string(path.join("a")).unwrap(), "three");
    assert!(!path.join("inner/b").exists());
    let nothing = copy_of(&stores, &copies, &store_in(&there).join("no"), &mut |_, _| ()).unwrap_err();
    assert!(nothing.is_absent(), "{nothing}");
}

#[test]
fn copies_give_way_to_others_unless_they_are_used() {
    let (folder, stores) = room();
    let there = folder.path().join("there");
    fs::create_dir(&there).unwrap();
    for name in ["a", "b", "c"] {
        fs::write(there.join(name), [0; 400_000]).unwrap();
    }
    let copies = Copies::new(&folder.path().join("here"), 1_000_000);
    let copy = |copies: &Copies, name: &str| copy_of(&stores, copies, &store_in(&there).join(name), &mut |_, _| ());
    let first = copy(&copies, "a").unwrap();
    let second = copy(&copies, "b").unwrap();
    let said = copy(&copies, "c").unwrap_err().to_string();
    assert!(said.contains("REALITYSIM_CACHE_MB"), "{said}");
    assert!(first.exists() && second.exists());
    // Another program, which uses none of them.
    drop(copies);
    copy(&Copies::new(&folder.path().join("here"), 1_000_000), "c").unwrap();
    assert!(!first.exists() && second.exists());
}
