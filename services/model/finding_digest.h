// What says, in eight bytes, which findings stand: a sensor and its server compare it.
#ifndef RIPS_SERVICES_MODEL_FINDING_DIGEST_H_
#define RIPS_SERVICES_MODEL_FINDING_DIGEST_H_

#include <cstdint>

#include "services/model/observation.h"

namespace rips::model {

// Of what makes a finding the same one: kind, GUID, node and topic (FNV-1a, mixed). That of several
// is the sum, modulo 2^64; of none 0. Against loss and mistakes, not against a sensor that lies.
inline uint64_t DigestOf(const Finding& finding) {
  uint64_t hash = 0xcbf29ce484222325;
  const auto add = [&hash](const auto& bytes) {
    for (const auto byte : bytes) hash = (hash ^ static_cast<uint8_t>(byte)) * 0x100000001b3;
    hash = (hash ^ 0xff) * 0x100000001b3;  // in no text of UTF-8
  };
  add(finding.guid.bytes);
  add(finding.kind);
  add(finding.node);
  add(finding.topic);
  hash = (hash ^ (hash >> 30)) * 0xbf58476d1ce4e5b9;
  hash = (hash ^ (hash >> 27)) * 0x94d049bb133111eb;
  return hash ^ (hash >> 31);
}

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_FINDING_DIGEST_H_
