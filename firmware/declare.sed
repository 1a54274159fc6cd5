# The first line of every function of a sketch, as its declaration.
s/^((void|bool|uint8_t|uint16_t) [a-z_]+\(.*\)) \{.*$/\1;/p
