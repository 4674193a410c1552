from riemlayer.cli import main

main()
